"""From polled drives to a verdict: a model on a grid that polling can serve."""

from pathlib import Path

import numpy as np
import pytest

import dbc
from monitor.base import config
from monitor.bus.loop import Loop
from monitor.bus.polling.poller import ObdPoller
from monitor.inject.gateway import write_log
from monitor.model.step import Model
from monitor.pipeline import replay
from tests.helpers.bus.obd_conversation import PARAMETERS, Conversation
from tests.helpers.bus.obd_ecu import ObdEcu, SimulatedBus
from tests.helpers.drives.simulated_drives import WARM
from training.cli import main
from training.dyno.simulation import Experiment, simulate

PAIR = (dbc.path("obd2.dbc"), dbc.path("obd2.toml"))
BUS = ["--dbc", str(PAIR[0]), "--map", str(PAIR[1])]


def ecu_of(seed: int, until_s: float) -> ObdEcu:
    """Return an ECU on the highway."""
    experiment = Experiment(
        cycle="hwfet", vehicle=2051, seed=seed, duration_s=until_s, conditions=WARM
    )
    drive = simulate(experiment)
    return ObdEcu(np.arange(len(drive["engine_speed_rpm"])) * 0.01, drive)


def polled(setup: replay.Setup, seed: int, log: Path, until_s: float) -> dict[str, object]:
    """Poll a drive, record it and return what the loop says."""
    with SimulatedBus(ecu_of(seed, until_s), until_s=until_s, seed=seed) as bus:
        loop = Loop(bus, setup, record=log, say=lambda _: None, monotonic_s=lambda: bus.now_s)
        loop.attachments.append(ObdPoller(PARAMETERS))
        bus.stop = loop.stop
        loop.run()
    return loop.result("polled")


def test_a_model_with_samples_half_a_second_apart_judges_polled_drives(tmp_path: Path) -> None:
    # GIVEN a model fitted to polled drives on a grid of 0.5 s, its limits set by them
    model, logs = tmp_path / "slow.onnx", [str(tmp_path / f"drive{n}.log") for n in range(2)]
    for n, log in enumerate(logs):
        write_log(Path(log), Conversation(ecu_of(2_051_000 + n, 400.0)).run(400.0).frames)
    size = "--period 0.5 --lags 4 --hidden 6 --starts 1 --budget 0.02"
    assert main(["fit", *logs, *BUS, *size.split(), "--out", str(model)]) == 0
    assert Model.load(model).card.period_ns == 500_000_000
    # WHEN a further drive is polled and judged on the way
    setup = replay.set_up(model, [PAIR], config.load())
    live = polled(setup, 2_051_009, tmp_path / "further.log", 120.0)
    # THEN windows of 25 s are judged, none has a code, and the recording replays to the same
    again, _ = replay.replay(tmp_path / "further.log", setup)
    assert len(again["windows"]) >= 2
    for key in ("samples", "enabled_samples", "enable", "windows", "dtcs"):
        assert live[key] == again[key], key
    assert again["dtcs"] == []
    assert all(w["t_end_s"] - w["t_start_s"] == pytest.approx(24.5) for w in again["windows"])
