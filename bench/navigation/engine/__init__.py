"""Order and trust of data: which rows of a record are used when, and the state between pieces."""
