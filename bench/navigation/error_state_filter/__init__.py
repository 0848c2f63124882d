"""The compiled family: states, the rows of H of each sensor, propagation, gate, and the run of a filter."""
