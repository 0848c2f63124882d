"""Evaluation: errors against the truth, metrics of one run, statistics of many runs."""
