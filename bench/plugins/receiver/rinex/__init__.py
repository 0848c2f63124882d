"""Read RINEX 2 and 3 observation and navigation files of GPS and GLONASS; other systems are skipped.

An error is one line with the name of the file and the line number. A file is read line by line; memory grows
only with its number of satellites and epochs.
"""
