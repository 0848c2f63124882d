"""Conventions that the author of a solution may have mistaken."""
