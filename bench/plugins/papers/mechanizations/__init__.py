"""Further mechanizations for reading and comparison: frames, attitudes, rates, Earth models.

`solving` has the one call; `triads` the navigation frames, `attitude` the attitude algorithms, `coning` the
sample corrections, `earth_series` radii and gravity.
"""
