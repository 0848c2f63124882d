"""What of a run is plotted: lines, bands and dots, tab by tab.

Nothing here draws: `bench.views.recording` and `bench.views.report` do.
"""
