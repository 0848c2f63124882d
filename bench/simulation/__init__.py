"""The truth and the sensors: flight, sensors, and the signals that they share with the filters."""
