"""The matrix: many simulated drives, healthy and faulty, judged by the monitor, and the rates."""
