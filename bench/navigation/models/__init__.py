"""The built-in filters: loose and tight, smoother, sigma points, fixes alone, the source's own, graphs."""
