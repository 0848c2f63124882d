"""A factor graph, with gtsam.

gtsam navigates over a flat, resting Earth: a frame whose axes stay those of north, east and down at the
start, with one vector of gravity. What is missing is supplied (`bench.navigation.models.flat_frame`).
"""
