"""Numba kernels, and rows of matrices."""
