"""Records of a run, specs of what is simulated, and what was found."""
