"""Ranges in the error-state filter: their rows, the states of their errors, the ionosphere under them."""
