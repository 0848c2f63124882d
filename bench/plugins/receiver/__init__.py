"""A GNSS receiver: RINEX, SP3 and UBX files, fixes from ranges, and their pages."""

PUBLIC = {"solve_rinex": "bench.plugins.receiver.receiver_settings"}
"""Name in ``bench`` -> the module that holds it."""
