"""A GNSS receiver: RINEX, SP3, UBX, SBF and GnssLogger files, fixes from ranges, and their pages."""
