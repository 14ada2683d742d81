"""The NARX network: training, closed loop, choice of structure, export."""
