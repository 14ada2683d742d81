"""Reads tables whose cells are parted by |, with names and units in the first line."""

import numpy as np

from monitor.frames.tables.raw_table import RawColumn, RawTable


def open_pipes(path):
    """Return the raw table of a file; a profile finds the signals among its columns."""
    head, *lines = path.read_text().splitlines()
    names = [name.strip() for name in head.split("|")]
    cells = np.array([line.split("|") for line in lines], float)  # (n, n_columns)

    def read(wanted, notes):
        yield cells[:, [each.column for each in wanted]]

    return RawTable(path, "cells parted by |", tuple(map(RawColumn, names)), read)
