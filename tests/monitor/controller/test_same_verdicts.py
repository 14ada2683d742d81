"""The C monitor says of every replay log and of random samples what the Python monitor says."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.files import manifest
from monitor.base.types import FloatArray
from monitor.controller.export import export
from monitor.controller.tables import FURTHER
from monitor.judge.limits import Limits
from monitor.memory.codes import TESTS
from monitor.memory.reference import Reference
from monitor.model.card import Limit
from monitor.pipeline.replay import Setup, set_up
from tests.conftest import ROOT
from tests.helpers.drives.drive_tables import read
from tests.helpers.examples import inputs
from tests.helpers.models import c_monitor
from training.fleet.reading import Read

ODD = (np.nan, np.inf, -np.inf, 0.0, -1e30, 1e30, 1e-30, 3.4e38)
FLAGS = ("fuel_cut", "closed_loop", "sensor_ready")
QUALITIES = 7


def drive_of(
    random: np.random.Generator, logs: Sequence[FloatArray], names: Sequence[str]
) -> FloatArray:
    """Return a drive, (n, n_names + 1); its last column is the quality of the lambda signal."""
    pieces = []
    for _ in range(random.integers(2, 6)):
        log, n = logs[random.integers(len(logs))], int(random.integers(50, 900))
        begin = int(random.integers(max(len(log) - n, 1)))
        piece = log[begin : begin + n].copy()
        for _ in range(random.integers(4)):
            _change(piece, random, names)
        pieces.append(piece)
    return np.concatenate(pieces)


def _change(x: FloatArray, random: np.random.Generator, names: Sequence[str]) -> None:
    begin, end = sorted(random.integers(0, len(x) + 1, 2).tolist())
    inside, n, at = slice(begin, end), end - begin, names.index("lambda_measured")
    column, few = int(random.integers(len(names))), random.random(len(x)) < 0.03
    reading = np.where(x[inside, at] == 0.0, np.float32(1e-9), x[inside, at])
    match random.integers(10):
        case 0:
            x[inside, at] = reading + random.normal(0.0, 0.1)
        case 1:
            x[inside, at] = 1.0 / (1.0 + random.uniform(0.1, 1.5) * (1.0 / reading - 1.0))
        case 2:
            x[inside, at] = x[min(begin, len(x) - 1), at]
        case 3:
            x[inside, column] = random.choice(ODD)
        case 4:
            x[few, column] = random.choice(ODD)
        case 5:
            x[inside, -1] = random.integers(QUALITIES)
        case 6:
            x[few, -1] = random.integers(QUALITIES)
        case 7:
            x[inside, names.index(str(random.choice(FLAGS)))] = random.integers(2)
        case 8:
            x[inside, :-1] *= random.lognormal(0.0, 2.0, (n, len(names)))
        case 9:
            x[inside, at] = np.roll(reading, random.integers(30)) + random.normal(0.0, 0.01, n)


NAMES = sorted(manifest.load(ROOT / "replay_logs"))
Pair = tuple[c_monitor.Said, c_monitor.Said]
pytestmark = pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")


@pytest.fixture(scope="module")
def exported(setup: Setup, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("c")
    export(setup.model, setup.config, folder)
    return folder


@pytest.fixture(scope="module")
def driver(exported: Path) -> Path:
    return c_monitor.compiled(exported, exported / "driver")


@pytest.mark.parametrize("name", NAMES)
def test_every_verdict_of_a_log_is_the_same_in_c(name: str, setup: Setup, driver: Path) -> None:
    drive = read(name, setup)
    (python,) = c_monitor.in_python([drive.block], drive.names, setup)
    given = c_monitor.rows(drive.block, drive.names, c_monitor.source_of(setup))
    (c,) = c_monitor.in_c([driver, *c_monitor.ANY], [given])
    assert c_monitor.differences(python, c) == []


@pytest.fixture(scope="module")
def logs(setup: Setup) -> list[Any]:
    source = c_monitor.source_of(setup)
    drives = [read(name, setup) for name in NAMES if "micro" in name]
    return [c_monitor.rows(drive.block, drive.names, source) for drive in drives[::3]]


@pytest.fixture(scope="module")
def checked_driver(exported: Path) -> Path:
    """Give a driver that ends with an error at any undefined behaviour."""
    options = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    return c_monitor.compiled(exported, exported / "checked", options=options)


@pytest.fixture(scope="module")
def both(setup: Setup, logs: list[Any], checked_driver: Path) -> Callable[[int], list[Pair]]:
    """Give a function that lets both monitors judge the random drives of a seed."""
    source = c_monitor.source_of(setup)

    def judged(seed: int) -> list[Pair]:
        random = np.random.default_rng(seed)
        drives = [drive_of(random, logs, source.names) for _ in range(5)]
        python = [
            said
            for drive in drives
            for said in c_monitor.in_python([c_monitor.samples(drive, source)], source.names, setup)
        ]
        return list(
            zip(python, c_monitor.in_c([checked_driver, *c_monitor.ANY], drives), strict=True)
        )

    return judged


@inputs(100)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.filterwarnings("ignore:(overflow|invalid value):RuntimeWarning")
def test_broken_samples_do_no_harm_and_are_judged_alike(
    seed: int, both: Callable[[int], list[Pair]], setup: Setup
) -> None:
    # GIVEN pieces of drives with faults, values out of range, infinite or not valid
    # WHEN both monitors judge them
    # THEN they say the same; a name may differ where two faults explain a window alike
    for a, b in both(seed):
        found = c_monitor.differences(a, b)
        assert found == [] or c_monitor.differs_by_rounding(a, b, setup), found


@pytest.mark.parametrize("value", [0.93, 1.2])
def test_a_reading_that_jumps_to_one_value_is_intermittent_in_c_too(
    value: float, setup: Setup, logs: list[Any], driver: Path
) -> None:
    source, given = c_monitor.source_of(setup), logs[0].copy()
    at = source.names.index("lambda_measured")
    given[:, at] = np.where(np.arange(len(given)) % 97 < 5, np.float32(value), given[:, at])
    (python,) = c_monitor.in_python([c_monitor.samples(given, source)], source.names, setup)
    (c,) = c_monitor.in_c([driver, *c_monitor.ANY], [given])
    assert c_monitor.differences(python, c) == []
    assert "intermittent" in {fault for _, _, fault, _ in c.codes}


def test_the_vehicle_s_reference_is_an_input(setup: Setup, driver: Path) -> None:
    # GIVEN a sound sensor in a vehicle whose reference knows other offsets and a stronger gain
    name = next(each for each in NAMES if each.startswith("healthy_micro"))
    drive = read(name, setup)
    own = setup.limits.of_vehicle(Reference(0.09, 0.1, 1.1, 5), setup.config.bias)
    (python,) = c_monitor.in_python([drive.block], drive.names, setup, own)
    # WHEN the C monitor gets that reference
    given = c_monitor.rows(drive.block, drive.names, c_monitor.source_of(setup))
    reference = [str(own.offset_low), str(own.offset_high), str(own.gain), "0"]
    (c,) = c_monitor.in_c([driver, *reference], [given])
    # THEN it finds the same offset that this vehicle never had
    assert c_monitor.differences(python, c) == []
    assert any(fault == "biased_rich" for _, _, fault, _ in c.codes)


LOGS = ("gain_low_micro_trips_v110_s116.blf", "stuck_lean_micro_trips_v113_s119.blf")
LATE = {"lead_s": 0.17, "delays_s": (0.13, 0.25, 0.4, 0.66, 1.1, 1.9)}  # parts of a sample
BLIND = {"drives": 1, "found": dict.fromkeys(TESTS["response"], 0), "false": {}}
DRIVES = {"drives": 3, "found": {"gain_low": 3}, "false": {"gain_low": 1}}


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


@pytest.mark.parametrize("kind", ["trust", "blind", "foreign", "late", "bare"])
def test_another_card_other_settings_and_signals_give_the_same_verdicts(
    kind: str, drives: list[Read], tmp_path: Path
) -> None:
    # GIVEN a model that mistakes a fault, finds none or explained more in training, delays between
    # samples, or a controller without any signal but the model's, one with a name that is none in C
    own = {"air_mass_mg": 'Luft "T" [°C]'} if kind == "bare" else {}
    channels = set_up(None, [], config.load()).model.card.inputs
    setup = {
        "trust": lambda: other(trust=DRIVES),
        "blind": lambda: other(trust=BLIND),
        "foreign": lambda: other(trust=BLIND | {"found": {}, "explained": 1.99}),
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
        found = {each.outcome for each in python.verdicts}
        assert kind not in ("blind", "foreign") or "passed" not in found
        assert kind != "foreign" or found == {"inconclusive"}
