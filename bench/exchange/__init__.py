"""Files of other people: trajectories, observations, ephemerides and almanacs of satellites."""
