"""Bad input gets one clear line and exit code 2, or is counted and survived."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

import dbc
from monitor import cli, faults
from monitor.checksum import payload_checksum
from monitor.model import Model
from monitor.replay import shipped_model
from monitor.sources import read_frames
from monitor.types import Frame
from training.canlog import FrameBlock, write_log
from training.dyno.simulate import Experiment
from training.dyno.write import write

LAMBDA_ID, FUEL_ID = 0xC2, 0xC1
ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give one minute of a simulated drive as a log."""
    folder = tmp_path_factory.mktemp("drive")
    return write(
        Experiment(cycle="micro_trips", vehicle=50, seed=50, duration_s=60.0), folder, "log"
    )


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Return the error line of a command that must fail with exit code 2."""
    code = cli.main([str(a) for a in arguments])
    err = capsys.readouterr().err
    assert code == 2, err
    assert "Traceback" not in err
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    return lines[0]


def test_a_missing_file_is_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    line = refused(capsys, "replay", tmp_path / "nowhere.log")
    assert "nowhere.log" in line
    assert "No such file" in line


@pytest.mark.parametrize("suffix", ["log", "blf", "log.gz"])
def test_a_truncated_log_says_how_many_frames_came_before(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path, suffix: str
) -> None:
    whole = tmp_path / f"whole.{suffix}"
    write_log(whole, block(list(read_frames(drive))))
    cut = tmp_path / f"cut.{suffix}"
    cut.write_bytes(whole.read_bytes()[: int(whole.stat().st_size * 0.6) + 3])
    line = refused(capsys, "replay", cut)
    assert f"cut.{suffix}" in line
    assert "frames" in line


def test_a_corrupt_log_is_refused(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path
) -> None:
    lines = drive.read_text().splitlines(keepends=True)
    corrupt = tmp_path / "corrupt.log"
    corrupt.write_text("".join([*lines[:500], "(12.0) can0 0C2#zz\n", *lines[500:]]))
    line = refused(capsys, "replay", corrupt)
    assert "corrupt.log" in line
    assert "500 frames" in line


def test_a_file_of_no_known_format_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    other = tmp_path / "drive.docx"
    other.write_text("no log")
    assert "drive.docx" in refused(capsys, "replay", other)


def test_a_wrong_dbc_is_named_with_the_message_it_lacks(
    capsys: pytest.CaptureFixture[str], drive: Path
) -> None:
    line = refused(
        capsys, "replay", drive, "--dbc", dbc.path("rusefi.dbc"), "--map", dbc.path("o2_ecu.toml")
    )
    assert "rusefi.dbc" in line
    assert "ECU_Air" in line


def test_a_signal_that_the_map_names_and_the_dbc_has_not_is_named(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path
) -> None:
    own = tmp_path / "own.toml"
    own.write_text(dbc.path("o2_ecu.toml").read_text().replace('"RailPressure"', '"RailPresure"'))
    line = refused(capsys, "replay", drive, "--dbc", dbc.path("o2_ecu.dbc"), "--map", own)
    assert "own.toml" in line
    assert "RailPresure" in line


def test_a_map_that_lacks_an_input_of_the_model_says_which(
    capsys: pytest.CaptureFixture[str], drive: Path
) -> None:
    pair = ("--dbc", dbc.path("wideband.dbc"), "--map", dbc.path("wideband.toml"))
    assert "air_mass_mg" in refused(capsys, "replay", drive, *pair)


def test_dbc_and_map_come_in_pairs(capsys: pytest.CaptureFixture[str], drive: Path) -> None:
    assert "pairs" in refused(capsys, "replay", drive, "--dbc", dbc.path("o2_ecu.dbc"))


def test_a_file_that_is_no_onnx_model_is_refused(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path
) -> None:
    model = tmp_path / "model.onnx"
    model.write_bytes(b"\x00\x01 not a model")
    assert "model.onnx" in refused(capsys, "replay", drive, "--model", model)


def test_an_onnx_model_that_is_not_ours_is_refused(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path
) -> None:
    stranger = onnx.load(str(shipped_model()))
    del stranger.metadata_props[:]
    path = tmp_path / "stranger.onnx"
    onnx.save(stranger, str(path))
    line = refused(capsys, "replay", drive, "--model", path)
    assert "stranger.onnx" in line
    assert "card" in line


def test_a_model_whose_card_disagrees_with_its_graph_is_refused(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path
) -> None:
    path = tmp_path / "edited.onnx"
    edited = onnx.load(str(shipped_model()))
    card = json.loads(edited.metadata_props[0].value)
    edited.metadata_props[0].value = json.dumps(card | {"inputs": card["inputs"][:-1]})
    onnx.save(edited, str(path))
    line = refused(capsys, "replay", drive, "--model", path)
    assert "edited.onnx" in line
    assert "7" in line
    assert "6" in line


def test_an_unknown_setting_is_refused(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path
) -> None:
    settings = tmp_path / "own.toml"
    settings.write_text("[window]\nn_sample = 50\n")
    assert "n_sample" in refused(capsys, "replay", drive, "--config", settings)


def test_a_table_without_a_signal_of_the_model_says_which(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    table = tmp_path / "table.csv"
    table.write_text("time_s,lambda_measured\n0.0,1.0\n0.1,1.0\n")
    line = refused(capsys, "replay", table)
    assert "fuel_mass_mg" in line


def block(frames: list[Frame]) -> FrameBlock:
    """Return frames side by side."""
    data = np.zeros((len(frames), 8), dtype=np.uint8)
    for row, frame in zip(data, frames, strict=True):
        row[: len(frame.data)] = list(frame.data)
    return FrameBlock(
        np.array([f.t_ns for f in frames]),
        np.array([f.can_id for f in frames]),
        np.array([f.is_extended for f in frames]),
        np.array([len(f.data) for f in frames]),
        data,
    )


Change = Callable[[list[Frame]], list[Frame]]


def replayed(drive: Path, tmp_path: Path, change: Change) -> dict[str, Any]:
    """Return the result on a log whose frames were changed; the replay must survive it."""
    log, out = tmp_path / "changed.log", tmp_path / "out.json"
    write_log(log, block(change(list(read_frames(drive)))))
    assert cli.main(["replay", str(log), "--json", str(out)]) in (0, 1, 3)
    recording: dict[str, Any] = json.loads(out.read_text())["recordings"][0]
    return recording


def every(n: int, can_id: int, change: Callable[[Frame], Frame]) -> Change:
    """Change every n-th frame under an identifier."""

    def apply(frames: list[Frame]) -> list[Frame]:
        seen = 0
        out = []
        for frame in frames:
            seen += frame.can_id == can_id
            hit = frame.can_id == can_id and seen % n == 0
            out.append(change(frame) if hit else frame)
        return out

    return apply


def flip(frame: Frame) -> Frame:
    return frame._replace(data=bytes([frame.data[0] ^ 0x40]) + frame.data[1:])


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        ("length", every(10, LAMBDA_ID, lambda f: f._replace(data=f.data[:5]))),
        ("checksum", every(10, LAMBDA_ID, flip)),
    ],
)
def test_a_bad_frame_is_counted_and_survived(
    drive: Path, tmp_path: Path, reason: str, change: Change
) -> None:
    recording = replayed(drive, tmp_path, change)
    assert recording["counters"][reason] == pytest.approx(60 * 50 / 10, abs=1)
    assert recording["samples"] == 599
    assert recording["dtcs"] == []


def test_a_stuck_counter_is_counted_and_the_message_counts_as_missing(
    drive: Path, tmp_path: Path
) -> None:
    # GIVEN an ECU that repeats one lambda frame for ever, its checksum still right
    def freeze(frames: list[Frame]) -> list[Frame]:
        first = next(f for f in frames if f.can_id == LAMBDA_ID)
        return [f._replace(data=first.data) if f.can_id == LAMBDA_ID else f for f in frames]

    recording = replayed(drive, tmp_path, freeze)
    assert recording["counters"]["stuck"] > 2900
    assert [d["code"] for d in recording["dtcs"]] == ["U0100"]


def test_values_that_are_not_available_are_counted(drive: Path, tmp_path: Path) -> None:
    # the sensor is not ready for its first 15 s, its lambda is not available
    recording = replayed(drive, tmp_path, lambda frames: frames)
    assert recording["counters"]["not_available"] == pytest.approx(15 * 50, abs=2)


def test_time_that_runs_backwards_is_counted_and_survived(drive: Path, tmp_path: Path) -> None:
    def swap(frames: list[Frame]) -> list[Frame]:
        early = [f._replace(t_ns=f.t_ns - 2_000_000_000) for f in frames[6000:6010]]
        return [*frames[:6000], *early, *frames[6010:]]

    # candump logs keep the order of their lines
    recording = replayed(drive, tmp_path, swap)
    assert recording["counters"]["late"] == 10
    assert recording["samples"] == 599


def test_a_gap_of_seconds_gives_stale_samples_and_the_grid_goes_on(
    drive: Path, tmp_path: Path
) -> None:
    def gap(frames: list[Frame]) -> list[Frame]:
        start = frames[0].t_ns + 30_000_000_000
        return [f for f in frames if not start <= f.t_ns < start + 5_000_000_000]

    recording = replayed(drive, tmp_path, gap)
    assert recording["samples"] == 599
    assert recording["enable"]["inputs_valid"] == pytest.approx(1 - 4.7 / 60, abs=0.01)


def test_a_message_that_stops_blocks_the_judgement_and_is_counted(
    drive: Path, tmp_path: Path
) -> None:
    def stop(frames: list[Frame]) -> list[Frame]:
        end = frames[0].t_ns + 40_000_000_000
        return [f for f in frames if f.can_id != FUEL_ID or f.t_ns < end]

    recording = replayed(drive, tmp_path, stop)
    assert recording["enable"]["inputs_valid"] == pytest.approx(40.3 / 60, abs=0.01)
    assert recording["dtcs"] == []  # the fuel message is not the sensor's fault


def test_a_value_out_of_range_is_counted_and_gives_its_code(drive: Path, tmp_path: Path) -> None:
    def implausible(frame: Frame) -> Frame:
        data = bytearray(frame.data)
        data[0:2] = (1000).to_bytes(2, "little")  # lambda 0.24
        data[7] = payload_checksum("crc8_sae_j1850_id", LAMBDA_ID, bytes(data), 7)
        return frame._replace(data=bytes(data))

    recording = replayed(drive, tmp_path, every(1, LAMBDA_ID, implausible))
    assert recording["counters"]["out_of_range"] > 2900
    assert [(d["code"], d["fault"]) for d in recording["dtcs"]] == [("P2A00", "out_of_range")]


def test_a_drive_too_short_to_be_judged_exits_with_3_and_says_why(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "short.log"
    write_log(log, block(list(read_frames(drive))[:2000]))
    assert cli.main(["replay", str(log)]) == 3
    assert "not judged: no window of enabled samples was filled" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["run", "check"])
def test_a_bus_that_cannot_be_opened_is_named(
    capsys: pytest.CaptureFixture[str], command: str
) -> None:
    line = refused(capsys, command, "-i", "socketcan", "-c", "nobus0")
    assert "nobus0" in line
    assert "internal" not in line


def test_a_manifest_of_something_else_is_no_manifest(drive: Path, tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    log.write_bytes(drive.read_bytes())
    out = tmp_path / "out.json"
    for text in ('{"name": "an app"}', "no json", '{"schema": "o2mon.manifest/1"}'):
        (tmp_path / "manifest.json").write_text(text)
        assert cli.main(["replay", str(log), "--json", str(out)]) in (0, 3)
        assert json.loads(out.read_text())["recordings"][0]["source"] is None


def test_a_reader_that_goes_away_changes_neither_result_nor_exit_code(
    drive: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.json"
    command = [sys.executable, "-m", "monitor.cli", "replay", str(drive), "--json", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT)
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(120) == cli.main(["replay", str(drive)])
    assert json.loads(out.read_text())["schema"] == "o2mon.replay/1"


def test_a_short_drive_does_not_heal_a_sensor_that_never_gets_ready(tmp_path: Path) -> None:
    # GIVEN a sensor that never gets ready and drives that are shorter than the patience
    fault = faults.resolve("not_ready")
    short = Experiment(cycle="micro_trips", vehicle=51, seed=51, duration_s=40.0, fault=fault)
    long = Experiment(cycle="micro_trips", vehicle=51, seed=52, duration_s=90.0, fault=fault)
    logs = [str(write(e, tmp_path, "log")) for e in (long, short, short, short, short)]
    out = tmp_path / "out.json"
    # WHEN they follow the drive in which it was found
    cli.main(["replay", *logs, "--memory", str(tmp_path / "m.db"), "--json", str(out)])
    # THEN the code stays
    recordings = json.loads(out.read_text())["recordings"]
    assert [[d["code"] for d in r["dtcs"]] for r in recordings] == [["P0134"]] * 5


def test_a_log_without_one_message_of_the_map_is_refused_and_no_fault(
    capsys: pytest.CaptureFixture[str], drive: Path
) -> None:
    pair = ("--dbc", dbc.path("rusefi.dbc"), "--map", dbc.path("rusefi.toml"))
    line = refused(capsys, "replay", drive, *pair)
    assert "drive" in line
    assert "wrong --dbc or --map" in line


def test_a_table_of_blanks_is_refused_and_no_fault(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path
) -> None:
    names = ["time_s", *Model.load(shipped_model()).card.input_names, "lambda_measured"]
    rows = [f"{i / 10}" + ",nan" * (len(names) - 1) for i in range(900)]
    table = tmp_path / "blank.csv"
    table.write_text("\n".join([",".join(names), *rows]) + "\n")
    assert "lambda_measured" in refused(capsys, "replay", table)


@pytest.mark.parametrize("option", ["--json", "--html"])
def test_a_result_that_cannot_be_written_is_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path, option: str
) -> None:
    line = refused(capsys, "replay", drive, option, tmp_path / "nowhere" / "out")
    assert "the folder does not exist" in line


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "--seed", "-1"],
        ["simulate", "--effect", "wall_film=nan"],
        ["simulate", "--fault", "gain_low=1.5"],
        ["simulate", "--fault", "sticky"],
        ["simulate", "--cycle", "nedc"],
        ["simulate", "--fault", "gain_low", "--fault-start", "1000", "--duration", "20"],
    ],
)
def test_a_drive_that_cannot_be_simulated_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str]
) -> None:
    from training import cli as train

    assert train.main([*arguments, "--out", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["run", "check"])
def test_without_log_and_bus_the_command_says_what_it_wants(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setenv("CAN_INTERFACE", "")
    assert "-i" in refused(capsys, command)


def test_a_log_and_a_bus_at_once_are_too_much(
    capsys: pytest.CaptureFixture[str], drive: Path
) -> None:
    assert "either" in refused(capsys, "check", drive, "-i", "virtual", "-c", "x")


def test_check_says_of_a_log_that_all_is_there(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path
) -> None:
    assert cli.main(["check", str(drive)]) == 0
    out = capsys.readouterr().out
    assert "the model has all it needs" in out
    assert "lambda_measured" in out
    # and of one from which the fuel has gone that it has stopped
    log = tmp_path / "stopped.log"
    frames = list(read_frames(drive))
    end = frames[0].t_ns + 30_000_000_000
    write_log(log, block([f for f in frames if f.can_id != FUEL_ID or f.t_ns < end]))
    assert cli.main(["check", str(log)]) == 3
    assert "the model lacks: fuel_mass_mg" in capsys.readouterr().out


def test_a_run_on_a_silent_bus_ends_with_3_and_says_that_nothing_came(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["run", "-i", "virtual", "-c", "silent", "--duration", "0.3"]) == 3
    assert "nothing was received" in capsys.readouterr().out
