"""Small errors made on purpose in a copy of bench, to see whether a test detects them: ``make mutants``."""
