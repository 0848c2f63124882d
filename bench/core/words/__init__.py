"""Words, colours and exceptions that all screens and pages share."""
