"""Streaming monitor for the upstream wideband oxygen sensor.

The modules read in the order of the data: sources, decode, assemble, enable, model, residual,
window, evaluate, debounce, dtc; ``pipeline`` joins them without I/O.
"""

__version__ = "0.1.0"
