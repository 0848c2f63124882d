"""Filters of others: classes, programs and solutions in files."""
