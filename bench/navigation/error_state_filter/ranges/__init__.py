"""Ranges in the error-state filter: rows of H, error states, and the ionosphere."""
