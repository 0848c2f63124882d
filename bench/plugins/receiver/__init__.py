"""A GNSS receiver: RINEX, SP3 and UBX files, fixes from ranges, and their pages."""
