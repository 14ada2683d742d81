"""Samples of tables: rows onto the sample grid, values outside their range as NaN."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from monitor.base.counts import plain
from monitor.base.errors import RecordingError
from monitor.base.runs import runs
from monitor.base.signals import OUTPUT, plausible_range
from monitor.base.types import BoolArray, FloatArray, Quality, QualityArray, SampleBlock
from monitor.frames.profiles.profile import STOICH_AFR
from monitor.frames.profiles.times import held
from monitor.grid.block_assembler import assemble_arrays, check_grid
from monitor.grid.tables import UNIFORM, Table, round_period_ns, uniform_period_ns

READY: Final = "sensor_ready"
AIR: Final = ("air_mass_mg", "maf_kg_h", "engine_speed_rpm")
CYLINDERS: Final = (2, 16)  # of an engine whose sensor is judged
RUNNING_RPM: Final = 500.0


def table_block(table: Table, names: Sequence[str], period_ns: int | None = None) -> SampleBlock:
    """Return a table's samples; on a grid a value is held for 0.5 s or three rows' time.

    names : columns wanted, in this order
    period_ns : grid period; None uses a table that is uniform within 1 % sample for sample
    Raises RecordingError if a column is missing, the period is impossible or as ``check_unit``.
    """
    missing = [name for name in names if name not in table.names]
    if missing:
        raise RecordingError(f"{table.path}: has no column {', '.join(missing)}")
    check_unit(table)
    block = _on_grid(table, _held(table, names), names, period_ns)
    if OUTPUT not in names or READY not in names:
        return block
    quality, column = block.quality.copy(), names.index(OUTPUT)
    is_ready = block.values[:, names.index(READY)] > 0.0
    # a ready sensor has a reading: the logger left it out
    quality[is_ready & (quality[:, column] == Quality.INVALID), column] = Quality.GAP
    return block._replace(quality=quality)


def _held(table: Table, names: Sequence[str]) -> FloatArray:
    """Return columns, (n, n_names), short blanks filled with the value before, which is counted.

    A blank that is too long to be filled, or never ends, stays whole. A sensor that is not ready
    has no reading. The reader of a logger's file has held its values.
    """
    cells = table.values[:, [table.names.index(name) for name in names]]
    if table.profile or not np.isnan(cells).any():
        return cells
    readings = [i for i, name in enumerate(names) if name == OUTPUT]
    filled = held(cells, table.t_ns, readings)
    for i in range(len(names)):
        for begin, end in runs(np.isnan(cells[:, i])):
            if end == len(cells) or np.isnan(filled[begin:end, i]).any():
                filled[begin:end, i] = np.nan
    if READY in table.names:
        unready = ~(table.values[:, table.names.index(READY)] > 0.0)
        for i in readings:
            filled[unready, i] = cells[unready, i]
    n_held = int((np.isnan(cells) & ~np.isnan(filled)).sum())
    notes = table.notes  # a table is looked at more than once
    notes.count("held_cells", max(0, n_held - notes.counts.get("held_cells", 0)))
    return filled


def check_unit(table: Table) -> None:
    """Raise RecordingError if lambda's or an air column can hold another quantity only.

    A lambda is never above the AFR of the richest mixture throughout and on both sides of
    stoichiometric AFR, and never below its range where fuel is cut and within it elsewhere.
    """
    _check_air(table)
    if OUTPUT not in table.names:
        return
    reading = table.values[:, table.names.index(OUTPUT)]
    known = reading[np.isfinite(reading)]
    least, _ = plausible_range(OUTPUT)
    where, wanted = f"{table.path}: {table.column_of(OUTPUT)}", f"as {OUTPUT}, lambda is wanted"
    if len(known) and least * STOICH_AFR <= known.min() < STOICH_AFR < known.max():
        raise RecordingError(
            f"{where} is an air-fuel ratio ({known.min():.1f} to {known.max():.1f}) {wanted}: "
            f"divide it by {STOICH_AFR}, factor = {1.0 / STOICH_AFR:.5f} in --columns"
        )
    if "fuel_cut" in table.names:
        is_cut = table.values[np.isfinite(reading), table.names.index("fuel_cut")]
        cut, rest = (known[rows] for rows in (is_cut > 0.0, is_cut == 0.0))
        if len(cut) and len(rest) and np.median(cut) < least <= np.median(rest):
            raise RecordingError(
                f"{where} falls to {plain(np.median(cut), 3)} where fuel is cut: 1/lambda {wanted}"
            )


def _check_air(table: Table) -> None:
    """Raise RecordingError if air per stroke, air flow and speed are those of no four-stroke."""
    if not set(AIR) <= set(table.names):
        return
    per_stroke_mg, flow_kg_h, speed_rpm = (table.values[:, table.names.index(n)] for n in AIR)
    is_running = (speed_rpm >= RUNNING_RPM) & (per_stroke_mg > 0.0) & np.isfinite(flow_kg_h)
    if np.count_nonzero(is_running) < len(table.t_ns) / 10:
        return
    # a stroke of each cylinder every second turn: 60 / 2 / 1e6 kg/h for 1 mg and 1 rpm
    each = flow_kg_h[is_running] / (3e-5 * per_stroke_mg[is_running] * speed_rpm[is_running])
    cylinders = float(np.median(each))
    if not CYLINDERS[0] - 0.5 < cylinders < CYLINDERS[1] + 0.5:
        raise RecordingError(
            f"{table.path}: {table.column_of(AIR[1])} and {table.column_of(AIR[0])} are those of "
            f"{plain(cylinders, 2)} cylinders: one is in another unit than {AIR[1]} and {AIR[0]} "
            "say (an air flow in g/s: factor = 3.6 in --columns)"
        )


def _on_grid(
    table: Table, cells: FloatArray, names: Sequence[str], period_ns: int | None
) -> SampleBlock:
    """Return a table's cells, (n, n_names), as they are if rows are uniform, else on a grid."""
    places = [table.names.index(name) for name in names]
    values, quality = in_range(cells, names)
    pinned = None if table.pinned is None else table.pinned[:, places]
    own_ns = uniform_period_ns(table.t_ns)
    if own_ns is not None and (period_ns is None or abs(period_ns - own_ns) <= UNIFORM * own_ns):
        index = np.arange(len(values), dtype=np.int64)
        block = SampleBlock(index, table.t_ns[0] + index * own_ns, values, quality)
        return block if pinned is None else _marked(block, pinned)
    period_ns = period_ns or round_period_ns(table.t_ns)
    check_grid(period_ns)
    row_ns = int(np.median(np.diff(table.t_ns))) if len(table.t_ns) > 1 else 0
    timeout_ns = max(500_000_000, 3 * row_ns)
    cells = np.where(quality == Quality.OUT_OF_RANGE, np.inf, values)
    # a tick is pinned if any of its rows is: the marks pass the grid beside the values
    columns = cells if pinned is None else np.hstack([cells, pinned])
    both = (*names, *(f"{name} pinned" for name in names))[: columns.shape[1]]
    block = assemble_arrays(
        table.t_ns,
        [(table.t_ns, column) for column in columns.T],
        both,
        both,
        period_ns=period_ns,
        timeouts_ns=[timeout_ns] * len(both),
        longest_ns=timeout_ns,  # no row for so long: a pause
    )
    if pinned is None:
        return block
    n = len(names)
    marks = np.asarray(block.values[:, n:] > 0.0)
    block = SampleBlock(block.index, block.t_ns, block.values[:, :n], block.quality[:, :n])
    return _marked(block, marks)


def _marked(block: SampleBlock, pinned: BoolArray) -> SampleBlock:
    """Return the block with the quality of pinned values; a plausible one is kept."""
    quality = block.quality.copy()
    known = (quality == Quality.GOOD) | (quality == Quality.OUT_OF_RANGE)
    quality[pinned & known] = Quality.PINNED
    return block._replace(quality=quality)


def in_range(values: FloatArray, names: Sequence[str]) -> tuple[FloatArray, QualityArray]:
    """Return values, NaN where not plausible, and their quality; both (n, n_names)."""
    values = values.copy()
    quality = np.zeros(values.shape, dtype=np.uint8)
    for column, name in enumerate(names):
        cell = values[:, column]
        low, high = plausible_range(name)
        outside = (cell < low) | (cell > high) | np.isinf(cell)
        quality[np.isnan(cell), column] = Quality.INVALID
        quality[outside, column] = Quality.OUT_OF_RANGE
        cell[outside] = np.nan
    return values, quality
