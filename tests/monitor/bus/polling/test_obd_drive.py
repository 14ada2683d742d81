"""A polled drive: recorded, replayed, checked, run, and fitted to; what ``--obd`` refuses."""

import re
from pathlib import Path

import numpy as np
import pytest

import dbc
from monitor.base import config
from monitor.bus.loop import Loop
from monitor.bus.polling.poller import ObdPoller
from monitor.cli import main
from monitor.inject.gateway import write_log
from monitor.model.step import Model
from monitor.pipeline import replay
from tests.helpers.bus.obd_ecu import (
    PARAMETERS,
    Conversation,
    ObdEcu,
    SimulatedBus,
    answering,
    steady_ecu,
)
from tests.helpers.bus.played_bus import judged, run_on
from tests.helpers.drives.simulated_drives import WARM
from training.cli import main as o2train
from training.dyno.simulation import Experiment, simulate

PAIR = (dbc.path("obd2.dbc"), dbc.path("obd2.toml"))
BUS = ["--dbc", str(PAIR[0]), "--map", str(PAIR[1])]


def obd_setup(model: Path | None = None) -> replay.Setup:
    return replay.set_up(model, [PAIR], config.load())


def test_answers_to_another_tester_are_judged_as_in_a_replay_and_nothing_is_asked(
    tmp_path: Path,
) -> None:
    # GIVEN answers with up to six parameters, under 29 bits
    answers = Conversation(steady_ecu()).run(40.0).frames
    script = [frame._replace(can_id=0x18DAF110, is_extended=True) for frame in answers]
    live, bus = run_on(script, obd_setup(), record=tmp_path / "tester.log")
    again, _ = replay.replay(tmp_path / "tester.log", obd_setup())
    assert judged(live) == judged(again)
    assert live["dtcs"] == []
    assert live["enable"]["inputs_valid"] > 0.9
    assert bus.sent == []
    assert live["counters"]["unmapped"] == 1  # the mark of a live recording


def test_checking_asks_and_says_what_is_missing(capsys: pytest.CaptureFixture[str]) -> None:
    channel = "obd check"
    bus = ["-i", "virtual", "-c", channel, "--obd"]
    with answering(steady_ecu(supported=(0x05, 0x0C, 0x0D, 0x34)), channel):
        assert main(["check", *bus, "--seconds", "2"]) == 3
    said = capsys.readouterr().out
    assert "polled are the PIDs 05 34 0C 0D; not supported: " in said
    assert re.search(r"engine_speed_rpm .* 2100 .* plausible", said)
    assert re.search(r"missing for the model: .*fuel_mass_mg", said)
    assert "lambda_measured" not in said.splitlines()[-1]


def test_where_nobody_answers_a_check_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    bus = ["-i", "virtual", "-c", "obd nobody", "--obd"]
    assert main(["check", *bus, "--seconds", "1"]) == 3
    said = capsys.readouterr().out
    assert "nobody answers" in said
    assert re.search(r"OBD-II: \d requests, 0 answered, silent \d", said)


@pytest.mark.parametrize("command", ["run", "check"])
def test_what_cannot_be_asked_for_is_refused(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = [command, "-i", "virtual", "-c", "obd refused", "--obd"]
    own = ["--dbc", str(dbc.path("o2_ecu.dbc")), "--map", str(dbc.path("o2_ecu.toml"))]
    assert main([*bus, *own]) == 2
    assert "nothing to ask for by OBD-II" in capsys.readouterr().err
    assert main([*bus, "--obd-request", "7E8"]) == 2
    assert "0x7E8 is no identifier" in capsys.readouterr().err


def test_running_with_a_model_of_a_fast_grid_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    bus = ["-i", "virtual", "-c", "obd fast", "--obd"]
    assert main(["run", *bus, "--duration", "0.3", "--quiet"]) == 3
    said = capsys.readouterr().out
    assert "samples every 0.1 s, polling brings a signal about every 0.17 s" in said


def ecu_of(seed: int, until_s: float) -> ObdEcu:
    experiment = Experiment(
        cycle="hwfet", vehicle=2051, seed=seed, duration_s=until_s, conditions=WARM
    )
    drive = simulate(experiment)
    return ObdEcu(np.arange(len(drive["engine_speed_rpm"])) * 0.01, drive)


def polled(setup: replay.Setup, seed: int, log: Path, until_s: float) -> dict[str, object]:
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
    assert o2train(["fit", *logs, *BUS, *size.split(), "--out", str(model)]) == 0
    assert Model.load(model).card.period_ns == 500_000_000
    setup = obd_setup(model)
    live = polled(setup, 2_051_009, tmp_path / "further.log", 120.0)
    # THEN windows of 25 s are judged, none has a code, and the recording replays to the same
    again, _ = replay.replay(tmp_path / "further.log", setup)
    assert len(again["windows"]) >= 2
    for key in ("samples", "enabled_samples", "enable", "windows", "dtcs"):
        assert live[key] == again[key], key
    assert again["dtcs"] == []
    assert all(w["t_end_s"] - w["t_start_s"] == pytest.approx(24.5) for w in again["windows"])
