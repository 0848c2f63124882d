"""Files of other people: observations, ephemerides and almanacs of satellites."""
