"""Faults put into the frames of an ECU: of the sensor and of the frames, with what is expected."""
