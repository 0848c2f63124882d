"""Checks of a recording: clocks, axes, units and noise."""
