"""Does the covariance describe the errors: NEES, NIS and the verdict."""
