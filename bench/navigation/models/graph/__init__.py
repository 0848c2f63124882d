"""Estimators of gtsam: the invariant EKF on SE2(3), wrapped, and a smoother as a factor graph.

gtsam navigates over a flat, resting Earth: a frame whose axes stay those of north, east and down at the
start, with one vector of gravity. What is missing is supplied (`graph.flat_frame`).
"""
