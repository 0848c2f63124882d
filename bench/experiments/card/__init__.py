"""The card of a filter: a fixed suite of flights, its lines and their comparison."""
