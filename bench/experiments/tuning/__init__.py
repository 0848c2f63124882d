"""Tuning of the noise that a filter assumes."""
