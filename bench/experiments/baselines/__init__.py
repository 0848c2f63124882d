"""Accuracy regression: every metric of every noise draw, before and after a change of the code."""
