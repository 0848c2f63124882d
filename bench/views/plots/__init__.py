"""Contents of the plots of a run: lines, bands and dots, tab by tab.

Nothing here draws: `bench.views.recording` and `bench.views.report` do.
"""
