"""What of a run is plotted: lines, bands and dots, tab by tab.

Nothing here runs: `bench.views.recording` and `bench.views.report` do.
"""
