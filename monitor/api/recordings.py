"""Drives on disk and drives in arrays to verdicts."""

from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any

from monitor.api.verdict import Verdict
from monitor.base import config as settings
from monitor.base.errors import UsageError
from monitor.grid.arrays import table_of
from monitor.grid.tables import checked_columns
from monitor.memory.store import Memory
from monitor.model.step import Model
from monitor.pipeline import replay as replays

Buses = Sequence[tuple[str | Path, str | Path]]


def load_model(path: str | Path | None = None) -> Model:
    """Return a model file, checked, or the shipped model without a path.

    Its ``card`` says inputs, output, sample period, limits and training recordings; ``reset``,
    ``step`` and ``run_batch`` predict.
    Raises ModelError if the file is none, or card and graph disagree.

    >>> model = load_model()
    >>> model.card.output.name, model.card.period_ns / 1e9
    ('lambda_measured', 0.1)
    """
    return Model.load(path or replays.shipped_model())


def path_of(given: str | Path) -> Path:
    """Return the path of a file; raises UsageError for one that no system has."""
    if "\0" in str(given):
        raise UsageError(f"{str(given)!r}: a path holds no NUL")
    return Path(given)


def set_up(
    model: str | Path | Model | None = None,
    buses: Buses = (),
    columns: str | Path | None = None,
    config: str | Path | None = None,
    channel: str = "",
) -> replays.Setup:
    """Return model, settings and signals for judging; parameters as in ``replay``."""
    pairs = [(path_of(dbc), path_of(signal_map)) for dbc, signal_map in buses]
    loaded = settings.load(path_of(config) if config else None)
    names = checked_columns(path_of(columns)) if columns else None
    return replays.set_up(model, pairs, loaded, names, channel=channel)


def replay(
    recording: str | Path | Mapping[str, Any],
    *,
    model: str | Path | Model | None = None,
    buses: Buses = (),
    columns: str | Path | None = None,
    config: str | Path | None = None,
    memory: str | Path | None = None,
    series: bool = False,
    channel: str = "",
) -> Verdict:
    """Judge one drive as fast as possible, as ``o2mon replay`` does.

    recording : a CAN log, table or logger's file; or columns of equal length by name, with
        ``time_s`` among them: a dict of arrays, a polars or a pandas frame
    model : a model file or ``load_model``'s; default the shipped model
    buses : pairs of DBC and signal map for CAN logs; default the project's own ECU
    columns : columns map or profile of a table, or a shipped profile's name
    config : TOML file that changes the shipped settings
    memory : fault memory to go on from and to store into; without one both are empty
    series : keep measurement and prediction in ``Verdict.series``
    channel : of a log that holds several buses, the one that is meant
    Raises O2Error with one line that names the file or signal, what came and what is wanted.

    >>> import numpy as np
    >>> from monitor import load_model
    >>> card = load_model().card
    >>> columns = {name: np.full(1200, 1.0) for name in (*card.input_names, card.output.name)}
    >>> verdict = replay({"time_s": np.arange(1200) / 10, **columns})
    >>> verdict.has_fault, [code.code for code in verdict.codes]  # it never moves
    (True, ['P0134'])
    """
    if columns and not isinstance(recording, str | Path):
        raise UsageError(f"columns={columns} is for a file; name arrays by their signals")
    setup = set_up(model, buses, columns, config, channel)
    held = Memory(path_of(memory), hold=True) if memory else None
    with closing(held) if held else nullcontext():
        if isinstance(recording, str | Path):
            entry, trace = replays.replay(path_of(recording), setup, held, trace=series)
        else:
            table = table_of(recording, "arrays")
            entry, trace = replays.judged_table(table, None, setup, held, trace=series)
    return Verdict(entry, trace)
