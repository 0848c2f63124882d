"""Causes of an inconsistent run: the filter runs again without each possible cause."""
