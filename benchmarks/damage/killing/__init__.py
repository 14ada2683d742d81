"""Processes that are killed; each imports python-can, here without what reads .mf4."""

from monitor.frames.text.python_can import import_without_mdf

import_without_mdf()
