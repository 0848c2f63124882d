"""A factor graph, with gtsam.

gtsam navigates over a flat, resting Earth: a frame whose axes stay those of north, east and down at the
start, with one vector of gravity. What is missing is supplied (`bench.navigation.models.flat_frame`).
"""

ESTIMATORS = {
    "graph-smoother": {
        "title": "loose-15 as a factor graph of gtsam over a whole record with white fixes, slow "
        "(extra 'graph')",
        "model": "bench.plugins.graph.graph_options:GraphOptions",
        "package": "gtsam",
    },
}
"""Name of an estimator -> its row in `bench.navigation.built_in`."""
