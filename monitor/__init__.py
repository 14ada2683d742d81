"""Streaming monitor for the upstream wideband oxygen sensor.

The rooms stand in the order of the data: base, frames, decode, grid, model, memory, judge,
pipeline, report, bus, inject, mapping, cli. ``pipeline`` joins them without I/O.
"""

__version__ = "0.1.0"
