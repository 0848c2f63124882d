"""Words, colors and exceptions that all screens and pages share."""
