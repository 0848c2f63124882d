"""The verbs of the command line; each prints to the rich console that it gets."""
