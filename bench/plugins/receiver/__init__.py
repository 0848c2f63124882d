"""A GNSS receiver: RINEX, SP3, UBX and GnssLogger files, fixes from ranges, and their pages."""
