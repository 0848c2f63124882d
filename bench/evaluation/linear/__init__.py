"""Covariances of linear errors along a true motion: by source of error, and of the best linear estimator."""
