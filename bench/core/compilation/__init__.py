"""The door to numba: kernels, and rows of matrices."""
