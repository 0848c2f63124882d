"""Flights with a client: a program or an autopilot in the loop."""

PUBLIC = {"serve": "bench.plugins.hil.serving"}
"""Name in ``bench`` -> the module that holds it."""
