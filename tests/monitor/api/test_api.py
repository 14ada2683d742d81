"""The Python API says what the command says."""

import json
import logging
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import can
import numpy as np
import polars as pl
import pytest

import dbc
import monitor
from monitor import Code, Monitor, O2Error, OxygenSensorMonitor, load_model, replay
from monitor.cli import main
from monitor.grid.tables import read_table
from monitor.pipeline.events import DtcChanged, Ticks
from monitor.report.lines import print_recording
from tests.conftest import ROOT

LATE = ROOT / "replay_logs" / "delay_symmetric_micro_trips_v108_s112.blf"
CODES = ("P015A", "P015B")


@cache
def messages() -> list[can.Message]:
    """Return the log up to ten seconds behind its codes."""
    every = list(can.LogReader(LATE))
    return [message for message in every if message.timestamp < every[0].timestamp + 40.0]


def test_a_log_has_the_verdict_of_the_command(tmp_path: Path) -> None:
    out = tmp_path / "result.json"
    assert main(["replay", str(LATE), "--json", str(out), "--quiet"]) == 1
    told = json.loads(out.read_text())["recordings"][0]
    verdict = replay(LATE)
    assert verdict.to_dict() == told
    assert [code.code for code in verdict.codes] == list(CODES)
    assert verdict.has_fault and verdict.is_judged
    assert replay(LATE, channel="1").codes == verdict.codes
    with pytest.raises(O2Error, match="no channel 7, there"):
        replay(LATE, channel="7")
    assert "P015A delay_symmetric" in str(verdict)


def test_arrays_and_frames_have_the_verdict_of_the_table_they_come_from(tmp_path: Path) -> None:
    card = load_model().card
    t_s = np.arange(1200) / 10
    rng = np.random.default_rng(3)
    columns = {name: rng.uniform(0.9, 1.1, 1200) for name in card.input_names}
    columns[card.output.name] = np.ones(1200)
    drive = {**columns, "time_s": t_s}
    path = tmp_path / "drive.csv"
    pl.DataFrame({"time_s": t_s, **columns}).write_csv(path)
    from_file = replay(path, series=True)
    assert from_file.has_fault  # a sensor that never moves
    for recording in (drive, pl.DataFrame(drive)):
        verdict = replay(recording, series=True)
        assert verdict.codes == from_file.codes
        assert verdict.entry["windows"] == from_file.entry["windows"]
        np.testing.assert_array_equal(verdict.series.predicted, from_file.series.predicted)
    assert read_table(path).names == tuple(columns)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("drive\0.csv", "a path holds no NUL"),
        ({"lambda_measured": [1.0]}, "no column time_s"),
        ({"time_s": [0.0, 1.0], "lambda_measured": [1.0]}, "one length"),
        ({"time_s": [0.0], "lambda_measured": ["one"]}, "column lambda_measured: numbers"),
        ({"time_s": [0.0, 0.1], "lambda_measured": [1.0, 1.0]}, "the model needs air_mass_mg"),
    ],
)
def test_what_cannot_be_judged_is_named(columns: Any, says: str) -> None:
    with pytest.raises(O2Error, match=says):
        replay(columns)


def test_times_in_milliseconds_are_told() -> None:
    ones = {name: np.ones(1200) for name in (*load_model().card.input_names, "lambda_measured")}
    with pytest.raises(O2Error, match=r"samples every 100 s.*is its time in ms\? s are wanted"):
        replay({"time_s": np.arange(1200) * 100.0, **ones})


def test_frames_one_by_one_give_the_codes_of_the_log() -> None:
    with Monitor(series=True) as live:
        for message in messages():
            live.push(message)
        live.push(can.Message(is_error_frame=True))
        verdict = live.verdict
    assert [(c.code, c.t_s) for c in verdict.codes] == [(c.code, c.t_s) for c in replay(LATE).codes]
    assert verdict.entry["counters"]["skipped"] == 1
    assert verdict.to_polars().columns == ["t_s", "measured", "predicted", "enabled", "fault_flag"]
    assert len(verdict.windows_to_polars()) == len(verdict.entry["windows"])


def listen(listener: OxygenSensorMonitor, now: Callable[[float], None]) -> None:
    for message in messages():
        now(message.timestamp)
        listener.on_message_received(message)


class Clock:
    now_s = 0.0

    def set(self, t_s: float) -> None:
        self.now_s = t_s

    def __call__(self) -> float:
        return self.now_s


def test_a_listener_of_python_can_tells_codes_as_they_come_whatever_the_user_s_function_does(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock, told = Clock(), list[tuple[Code, bool]]()

    def tell(code: Code) -> None:
        told.append((code, listener.verdict.has_fault))
        raise ValueError(code.code)

    listener = OxygenSensorMonitor(on_code=tell, monotonic_s=clock)
    notifier = threading.Thread(target=listen, args=(listener, clock.set), daemon=True)
    with caplog.at_level(logging.ERROR, logger="o2_monitor"):
        notifier.start()
        notifier.join(60.0)
    assert [(code.code, code.state) for code, _ in told] == [(code, "pending") for code in CODES]
    assert told[0] == (listener.verdict.codes[0], True)
    assert len(caplog.records) == len(CODES)


def test_a_code_of_an_earlier_drive_is_not_told_again_while_its_test_passes(tmp_path: Path) -> None:
    memory, told, clock = tmp_path / "o2.db", list[Code](), Clock()
    (missing,) = replay(next(LATE.parent.glob("signal_missing_*.blf")), memory=memory).codes
    listener = OxygenSensorMonitor(memory=memory, on_code=told.append, monotonic_s=clock)
    listen(listener, clock.set)
    listener.stop()
    assert missing.code == "U0100" and [each.code for each in told] == [*CODES]


def test_a_listener_hears_a_bus_fall_silent_by_its_ticks() -> None:
    clock, told = Clock(), list[Code]()
    listener = OxygenSensorMonitor(on_code=told.append, monotonic_s=clock)
    listen(listener, clock.set)
    end_s = clock.now_s
    for k in range(60):
        clock.set(end_s + 0.5 * k)
        listener.tick()
    assert "U0100" in [code.code for code in told]


def test_an_undecided_test_hides_neither_what_failed_nor_what_passed() -> None:
    # GIVEN a late sensor, and the same drive cut off before the response test decides
    tests = replay(LATE).tests
    clock = Clock()
    listener = OxygenSensorMonitor(monotonic_s=clock)
    for message in messages()[: len(messages()) * 7 // 10]:
        clock.set(message.timestamp)
        listener.on_message_received(message)
    short = listener.verdict
    assert tests.pop("response") == "failed"
    assert set(tests.values()) == {"passed"}
    assert not short.is_judged
    assert short.tests["response"] == "undecided"
    assert short.tests["range"] == "passed"
    assert "  passed: communication, range" in "\n".join(print_recording(short.entry))


def test_a_notifier_feeds_the_listener_and_closes_its_memory(tmp_path: Path) -> None:
    memory = tmp_path / "o2.db"
    with can.Bus("api", interface="virtual") as ear, can.Bus("api", interface="virtual") as mouth:
        listener = OxygenSensorMonitor(memory=memory)
        notifier = can.Notifier(ear, [listener], timeout=0.01)
        for message in messages()[:200]:
            mouth.send(message)
        mouth.send(can.Message(arbitration_id=0x7FF, data=b"end"))
        while listener.verdict.entry["counters"]["unmapped"] == 0:
            pass
        notifier.stop()
    verdict = replay(LATE, memory=memory)  # nobody holds it any more
    assert verdict.entry["memory"]["state"] == "ok"
    assert verdict.has_fault


def test_a_monitor_that_cannot_be_made_holds_no_memory(tmp_path: Path) -> None:
    memory = tmp_path / "o2.db"
    memory.write_bytes(b"o2mon torn")
    with pytest.raises(O2Error, match="the model needs air_mass_mg"):
        Monitor(buses=[(dbc.path("wideband.dbc"), dbc.path("wideband.toml"))], memory=memory)
    with Monitor(memory=memory) as live:
        assert "begin anew" in live.notes[0]
        first, lost, *_ = (each for message in messages()[:99] for each in live.push(message))
    assert isinstance(first, Ticks) and isinstance(lost, DtcChanged)  # time begins with a tick


def test_a_result_says_what_is_in_it_on_a_line_and_in_a_notebook() -> None:
    verdict = replay(LATE)
    told = repr(verdict)
    assert told.startswith(f"<Verdict recording: {LATE}, verdict: FAULT: P015A")
    assert told.endswith(f" of {verdict.entry['samples']} samples, windows: 42>")
    assert "<th>windows</th><td>42</td>" in verdict._repr_html_()
    odd = replace(verdict, entry={**verdict.entry, "path": "<script>"})
    assert "<script>" not in odd._repr_html_()
    assert "kind: narx, inputs: air_mass_mg fuel_mass_mg" in repr(load_model())
    assert dir(monitor) == monitor.__all__
    with pytest.raises(O2Error, match="columns=cobb is for a file"):
        replay({"time_s": np.arange(9.0)}, columns="cobb")
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = monitor.nothing


def test_the_version_is_said_before_any_library_is_loaded() -> None:
    code = (
        "import sys; from monitor.cli import main\n"
        "try: main(['--version'])\n"
        "except SystemExit: print(sorted({'numpy', 'can', 'onnxruntime'} & set(sys.modules)))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines() == [f"o2mon {monitor.__version__}", "[]"]
