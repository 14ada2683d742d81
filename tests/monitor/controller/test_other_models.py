"""The C monitor is that of any model, settings and signals, not of the shipped ones alone."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor.base import config
from monitor.controller.export import export
from monitor.controller.tables import FURTHER
from monitor.judge.limits import Limits
from monitor.memory.codes import TESTS
from monitor.model.card import Limit
from monitor.pipeline.replay import Setup, set_up
from tests.helpers.drives.drive_tables import read
from tests.helpers.models import c_monitor
from training.fleet.reading import Read

LOGS = ("gain_low_micro_trips_v110_s116.blf", "stuck_lean_micro_trips_v113_s119.blf")
LATE = {"lead_s": 0.17, "delays_s": (0.13, 0.25, 0.4, 0.66, 1.1, 1.9)}  # parts of a sample
BLIND = {"drives": 1, "found": dict.fromkeys(TESTS["response"], 0), "false": {}}
DRIVES = {"drives": 3, "found": {"gain_low": 3}, "false": {"gain_low": 1}}
pytestmark = pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")


@pytest.fixture(scope="module")
def drives(setup: Setup) -> list[Read]:
    return [read(name, setup) for name in LOGS]


def other(response: dict[str, Any] | None = None, **card: Any) -> Setup:
    """Return the shipped setup with other fields of the card, or settings of the response."""
    own = config.load()
    own = replace(own, response=replace(own.response, **(response or {})))
    setup = set_up(None, [], config.load())
    limits = {name: Limit(value, "", "") for name, value in card.pop("limits", {}).items()}
    setup.model.card = replace(setup.model.card, **card, limits=setup.model.card.limits | limits)
    return replace(setup, config=own, limits=Limits.from_card(setup.model.card, own, "own"))


@pytest.mark.parametrize("kind", ["still", "trust", "blind", "late", "bare"])
def test_another_card_other_settings_and_signals_give_the_same_verdicts(
    kind: str, drives: list[Read], tmp_path: Path
) -> None:
    # GIVEN a model whose reading may stand still, that mistakes a fault or finds none, delays
    # between samples, or a controller without any signal but the model's, one with a name that is
    # none in C
    own = {"air_mass_mg": 'Luft "T" [°C]'} if kind == "bare" else {}
    channels = set_up(None, [], config.load()).model.card.inputs
    setup = {
        "still": lambda: other(limits={"still_s": 40.0, "still_end_s": 300.0}),
        "trust": lambda: other(trust=DRIVES),
        "blind": lambda: other(trust=BLIND),
        "late": lambda: other(LATE),
        "bare": lambda: other(inputs=[replace(c, name=own.get(c.name, c.name)) for c in channels]),
    }[kind]()
    inputs = setup.model.card.input_names
    without = [name for name in FURTHER if name not in inputs] if kind == "bare" else []
    export(setup.model, setup.config, tmp_path, without)
    program = c_monitor.compiled(tmp_path, tmp_path / "driver")
    source = replace(c_monitor.source_of(setup), without=without)
    for drive in drives:
        # WHEN both monitors judge a drive
        there = [own.get(name, name) for name in drive.names]
        names = [name for name in there if name in source.names]
        at = [there.index(name) for name in names]
        values, quality = drive.block.values[:, at], drive.block.quality[:, at]
        block = drive.block._replace(values=values, quality=quality)
        (python,) = c_monitor.in_python([block], names, setup)
        given = c_monitor.rows(block, names, source)
        (c,) = c_monitor.in_c([program, *c_monitor.ANY], [given])
        # THEN they say the same
        assert python.verdicts
        assert not np.isnan(given[:, : len(inputs)]).all()
        assert c_monitor.differences(python, c) == []
        assert kind != "blind" or "passed" not in {each.outcome for each in python.verdicts}
