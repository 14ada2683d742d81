"""Checks a table or a logger's file: profile, signals with column, unit, range and rate."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.config import load
from monitor.base.counts import counted, plain
from monitor.base.signals import BY_NAME, OUTPUT, plausible_range
from monitor.base.types import BoolArray, FloatArray, Quality, QualityArray
from monitor.frames.profiles.profile import shipped
from monitor.frames.profiles.recognition import recognised
from monitor.frames.tables.readers import open_table
from monitor.grid.table_samples import in_range
from monitor.grid.tables import BLANK, TIME, Table, read_table, rename, table_period_ns
from monitor.judge.catalyst.watch import VOLTAGE
from monitor.model.card import ModelCard
from monitor.pipeline.recordings import table_of_model

# signals whose absence costs something, and what
WORTH: Final = {
    "lambda_measured": "nothing can be judged without it",
    "engine_speed_rpm": "dead time and charge need it",
    "fuel_mass_mg": "fuel or pulse width tells lambda before the sensor does",
    "manifold_pressure_kpa": "load",
    "closed_loop": "open loop cannot be told from closed loop",
    "fuel_cut": "fuel cut cannot be told from a lean sensor",
    "sensor_ready": "a cold sensor cannot be told from a faulty one",
    "coolant_temperature_degc": "a cold engine cannot be told from a warm one",
    "battery_voltage_v": "the injectors' dead time depends on it",
}
LEAST_SHARE: Final = 0.0005  # of the rows that is told
AT_END_SHARE: Final = 0.5  # of a lambda's readings at its least or greatest value that is told
SLOWEST_S: Final = 10.0  # between rows; no logger of a drive is slower
ENGINE: Final = "engine_speed_rpm"
_INSTEAD: Final = {"manifold_pressure_kpa": ("air_mass_mg", "maf_kg_h", "load_g_per_rev")}


@dataclass(frozen=True, slots=True)
class TableCheck:
    """The signals of a table.

    runs : where the engine runs, shape (n,); everywhere if no signal says it
    """

    table: Table
    header: tuple[str, ...]  # lines about the file
    runs: BoolArray

    @property
    def present(self) -> set[str]:
        """Return the signals with at least one plausible value."""
        values, _ = in_range(self.table.values, self.table.names)
        good = np.flatnonzero(np.isfinite(values).any(axis=0))
        return {self.table.names[i] for i in good.tolist()}

    def missing(self, needed: Iterable[str]) -> list[str]:
        """Return the needed signals without a plausible value."""
        present = self.present
        return [name for name in needed if name not in present]

    @property
    def is_output_pinned(self) -> bool:
        """Return whether the sensor's reading stands at an end of its range throughout."""
        table = self.table
        if table.pinned is None or OUTPUT not in table.names:
            return False
        i = table.names.index(OUTPUT)
        return bool((table.pinned[:, i] | np.isnan(table.values[:, i])).all())

    def lines(self) -> Iterator[str]:
        """Yield the lines of the report."""
        table = self.table
        span_s = (int(table.t_ns[-1]) - int(table.t_ns[0])) / 1e9
        rate = f", {plain((len(table.t_ns) - 1) / span_s, 3)} rows/s" if span_s > 0 else ""
        yield from self.header
        yield (
            f"{len(table.t_ns)} rows in {span_s:.1f} s{rate}; "
            f"used on a grid of {table_period_ns(table) / 1e9:g} s"
        )
        if span_s > SLOWEST_S * (len(table.t_ns) - 1):
            yield (
                f"note: a row every {plain(span_s / (len(table.t_ns) - 1), 3)} s; are the times in "
                'ms? then time = { column = "…", unit = "ms" } in a profile'
            )
        width = max([len("from"), *(len(table.column_of(name)) for name in table.names)])
        yield (
            f"{'signal':<30}{'unit':<11}{'from':<{width}}{'rate':>9}{'minimum':>11}{'median':>11}"
            f"{'maximum':>11}{'possible':>16}  verdict"
        )
        values, quality = in_range(table.values, table.names)
        for i, name in enumerate(table.names):
            yield self._line(name, values[:, i], quality[:, i], width, span_s)
        if not self.runs.all() and self.runs.any():
            n = counted(int(self.runs.sum()), "row")
            yield f"minimum, median and maximum: of the {n} in which the engine runs"
        for note in table.notes.lines:
            yield f"note: {note}"
        for name, column in table.blank.items():
            if name not in self.present:
                yield f"no value: {name} (column {column} {BLANK})"
        for name, cost in WORTH.items():
            if name not in self.present and not self.present & {*_INSTEAD.get(name, ())}:
                yield f"missing: {name} ({cost})"

    def _line(
        self, name: str, values: FloatArray, quality: QualityArray, width: int, span_s: float
    ) -> str:
        place = self.table.names.index(name)
        good = values[np.isfinite(values)]
        changes = int((np.diff(good) != 0.0).sum())
        n_out = int((quality == Quality.OUT_OF_RANGE).sum())
        pinned = self.table.pinned
        n_pinned = 0 if pinned is None else int(pinned[:, place].sum())
        unit = BY_NAME[name].unit if name in BY_NAME else ""
        if len(good):
            n_told = self.table.updates.get(name, len(good))  # others are held over blank cells
            rate = f"{plain((min(n_told, len(good)) - 1) / span_s, 3)}/s" if span_s > 0 else ""
            seen = values[self.runs & np.isfinite(values)]
            seen = seen if len(seen) else good
            low, middle, high = map(plain, (seen.min(), np.median(seen), seen.max()))
            numbers = f"{rate:>9}{low:>11}{middle:>11}{high:>11}"
        else:
            numbers = " " * 42
        limits = (f"{round(each, 3) + 0.0:g}" for each in plausible_range(name))
        possible = " to ".join(limits) if name in BY_NAME else "any"
        n = len(values)
        faults = [
            f"{100 * count / n:.1f} % {what}"
            for count, what in (
                (n - len(good) - n_out, "blank"),
                (n_out, f"out of range{self._came(place, quality == Quality.OUT_OF_RANGE)}"),
                (n_pinned, "pinned at an end of the range"),
            )
            if count >= LEAST_SHARE * n
        ]
        if len(good) > 1 and not changes:
            faults.append("constant")
        elif name == OUTPUT and len(good):
            ends = [(end, float((good == end).mean())) for end in (good.min(), good.max())]
            faults += [f"{s:.0%} at {plain(end)}, its end" for end, s in ends if s >= AT_END_SHARE]
        verdict = ", ".join(faults) or "plausible"
        column = f"{self.table.column_of(name):<{width}}"
        return f"{name:<30}{unit:<11}{column}{numbers}{possible:>15}  {verdict}"

    def _came(self, place: int, outside: BoolArray) -> str:
        """Return in words which values are out of range, and which are wanted."""
        came = self.table.values[outside, place]
        came = came[np.isfinite(came)]
        if not len(came):
            return ""
        low, high = plausible_range(self.table.names[place])
        is_gauge = self.table.names[place].endswith("pressure_kpa") and came.min() < 0.0
        hint = "; a gauge pressure? offset = 101.3 in a profile" if is_gauge else ""
        low, high = (round(each, 3) + 0.0 for each in (low, high))  # ranges have a tiny margin
        values = " to ".join(dict.fromkeys(plain(each) for each in (came.min(), came.max())))
        return f" ({values}, wanted {low:g} to {high:g}{hint})"


def check_table(
    path: Path, columns: Path | None = None, card: ModelCard | None = None
) -> TableCheck:
    """Return the signals of a table.

    columns : columns map or profile, as of ``read_table``
    card : of a model, whose profile and further columns count
    Raises RecordingError as ``read_table``.
    """
    table = table_of_model(path, columns, card) if card else read_table(path, columns)
    header = [str(path)]
    if table.profile:
        raw = open_table(path)
        how = "given" if columns is not None else "recognised by its columns"
        own = recognised(raw) if columns is None else None
        if columns is None and (own is None or own.name != table.profile):
            how = "of the log that it is made of" if raw.names[0] == TIME else "of the model"
        elif own is not None and own.name not in shipped():
            how += f", your own of {own.file}"
        header.append(f"{raw.kind}, {len(raw.columns)} columns")
        header.append(f"profile: {table.profile}, {how}")
    return TableCheck(table, tuple(header), _runs(table))


def _runs(table: Table) -> BoolArray:
    if ENGINE not in table.names or ENGINE in table.blank:
        return np.full(len(table.t_ns), ENGINE not in table.blank)
    speed = table.values[:, table.names.index(ENGINE)]
    return np.asarray(speed >= load().plausibility.engine_running_rpm)


def advice(check: TableCheck) -> str:
    """Return the commands that a logger's file without a model allows."""
    if OUTPUT not in check.present:
        useful = "neither o2train fit nor o2mon replay can use this log"
        if VOLTAGE in check.present:
            useful = "o2mon replay judges only the catalyst and the sensor behind it"
        return "\n".join(filter(None, (f"no {OUTPUT}: {useful}", rename(check.table))))
    if check.is_output_pinned:
        return f"{OUTPUT} stands at an end of its range throughout: nothing to learn from"
    if not check.runs.any():
        return f"the engine never runs in this log by {ENGINE}: nothing to learn from"
    return (
        "o2train fit learns a model from healthy drives like this one; with it, "
        "o2mon check LOG --model MODEL.onnx says whether a log has what the model needs"
    )
