"""Mechanizations beside that of the filters, to be read and compared: frames, attitudes, rates, figures.

`solving` has the one call; `triads` the navigation frames, `attitude` the attitude algorithms, `coning` the
sample corrections, `earth_series` radii and gravity.
"""
