"""Records of a run, specs of the simulation, and findings."""
