"""Accuracy regression: every metric of every run, before and after a change of the code."""
