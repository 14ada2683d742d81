"""The detection matrix: rates of the monitor on many simulated drives, healthy and faulty."""
