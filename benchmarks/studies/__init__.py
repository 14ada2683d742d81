"""Studies on simulated drives: the sensor, the catalyst and the gap workflow."""
