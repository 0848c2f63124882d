"""The card of an estimator: a fixed suite of flights, its lines and their comparison."""
