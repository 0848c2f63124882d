"""Consistency of a filter: does the covariance describe the errors? NEES, NIS and the verdict."""
