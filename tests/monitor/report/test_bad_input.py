"""Bad input gets one clear line and exit code 2, or does no harm."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import onnx
import pytest

import dbc
from monitor import cli
from monitor.frames.logs import read_frames
from monitor.inject.gateway import write_log
from monitor.model.model_file import metadata_of
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.conftest import ROOT
from tests.helpers.logs.replays import replays

Capture = pytest.CaptureFixture[str]


def refused(capsys: Capture, *arguments: str | Path) -> str:
    """Return the error line of a command that must fail with exit code 2."""
    code = cli.main([str(a) for a in arguments])
    err = capsys.readouterr().err
    assert code == 2, err
    assert "Traceback" not in err
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    return lines[0]


@pytest.fixture(scope="module")
def bad(ninety_seconds: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder with the drive and with files that are not what they should be."""
    folder = tmp_path_factory.mktemp("bad")
    lines = ninety_seconds.read_text().splitlines(keepends=True)
    own_map = dbc.path("o2_ecu.toml").read_text()
    names = ["time_s", *Model.load(shipped_model()).card.input_names, "lambda_measured"]
    blanks = [f"{i / 10}" + ",nan" * (len(names) - 1) for i in range(900)]
    for name, text in {
        "drive.log": "".join(lines),
        "brief.log": "".join(lines[:3]),
        "corrupt.log": "".join([*lines[:500], *["(12.0) can0 0C2#zz\n"] * 9, *lines[500:]]),
        "drive.docx": "no log",
        "own_map.toml": own_map.replace('"RailPressure"', '"RailPresure"'),
        "binary.onnx": "\x00\x01 not a model",
        "settings.toml": "[window]\nn_sample = 50\n",
        "few.csv": "time_s,lambda_measured\n0.0,1.0\n0.1,1.0\n",
        "blank.csv": "\n".join([",".join(names), *blanks]) + "\n",
    }.items():
        (folder / name).write_text(text)
    stranger, edited = (onnx.load(str(shipped_model())) for _ in range(2))
    del stranger.metadata_props[:]
    onnx.save(stranger, str(folder / "stranger.onnx"))
    card = json.loads(edited.metadata_props[0].value)
    own = card | {"inputs": card["inputs"][:-1]}
    onnx.helper.set_model_props(edited, metadata_of(json.dumps(own)))
    onnx.save(edited, str(folder / "edited.onnx"))
    for name in ("o2_ecu", "rusefi", "wideband"):
        for suffix in ("dbc", "toml"):
            shutil.copy(dbc.path(f"{name}.{suffix}"), folder)
    return folder


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("replay nowhere.log", ["nowhere.log", "No such file"]),
        ("replay corrupt.log", ["corrupt.log", "500 frames"]),
        ("replay brief.log", ["brief.log: shorter than one sample of the model's grid"]),
        ("replay drive.docx", ["drive.docx"]),
        # the message that a DBC lacks, a signal that it lacks, an input that a map lacks
        ("replay drive.log --dbc rusefi.dbc --map o2_ecu.toml", ["rusefi.dbc", "ECU_Air"]),
        ("replay drive.log --dbc o2_ecu.dbc --map own_map.toml", ["own_map.toml", "RailPresure"]),
        ("replay drive.log --dbc wideband.dbc --map wideband.toml", ["air_mass_mg"]),
        ("replay drive.log --dbc o2_ecu.dbc", ["pairs"]),
        ("replay drive.log --dbc rusefi.dbc --map rusefi.toml", ["drive", "wrong --dbc or --map"]),
        # no model, one of another program, one whose card disagrees with its graph
        ("replay drive.log --model binary.onnx", ["binary.onnx: not a usable ONNX file"]),
        ("replay drive.log --model stranger.onnx", ["stranger.onnx: no model card"]),
        (
            "replay drive.log --model edited.onnx",
            ["edited.onnx", "u has shape", "7", "its card says (batch, 6)"],
        ),
        ("replay drive.log --config settings.toml", ["n_sample"]),
        ("replay few.csv", ["fuel_mass_mg"]),
        ("replay blank.csv", ["lambda_measured"]),
        ("replay drive.log --json nowhere/out", ["the folder does not exist"]),
        ("check drive.log -i virtual -c x", ["--interface", "a CAN log"]),
        ("check -i socketcan -c nobus0", ["nobus0"]),
        ("run -i socketcan -c nobus0", ["nobus0"]),
        ("run", ["-i"]),  # neither log nor bus
        ("check", ["-i"]),
    ],
)
def test_what_cannot_be_judged_is_refused_in_one_line_that_names_it(
    command: str, words: list[str], bad: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(bad)
    monkeypatch.setenv("CAN_INTERFACE", "")
    line = refused(capsys, *command.split())
    assert all(word in line for word in words), line
    assert "internal" not in line


@pytest.mark.parametrize("suffix", ["log", "blf", "log.gz"])
def test_a_log_of_a_killed_logger_is_judged_as_far_as_it_goes_and_the_verdict_says_so(
    capsys: Capture, ninety_seconds: Path, tmp_path: Path, suffix: str
) -> None:
    # GIVEN a log that ends in the middle of a line, a container or a packed block
    whole = tmp_path / f"whole.{suffix}"
    write_log(whole, list(read_frames(ninety_seconds)))
    cut = tmp_path / f"cut.{suffix}"
    cut.write_bytes(whole.read_bytes()[: int(whole.stat().st_size * 0.6) + 3])
    code, (recording,) = replays(cut)
    # THEN text and JSON say where it ends, and the end is a gap of the log
    assert code in (0, 3)
    assert recording["counters"]["log_gaps"] == 1
    assert "cut short after" in recording["notes"][0]
    assert recording["notes"][0] in capsys.readouterr().out


def test_a_manifest_of_something_else_is_no_manifest(ninety_seconds: Path, tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    log.write_bytes(ninety_seconds.read_bytes())
    for text in ('{"name": "an app"}', "no json", '{"schema": "o2mon.manifest/1"}'):
        (tmp_path / "manifest.json").write_text(text)
        code, (recording,) = replays(log)
        assert code in (0, 3)
        assert recording["source"] is None


def test_a_reader_that_goes_away_changes_no_result(ninety_seconds: Path, tmp_path: Path) -> None:
    out, replay = tmp_path / "out.json", ["replay", str(ninety_seconds)]
    command = [sys.executable, "-m", "monitor.cli", *replay, "--json", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT)
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(120) == cli.main(replay)
    assert json.loads(out.read_text())["schema"] == "o2mon.replay/1"


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "--seed", "-1"],
        ["simulate", "--downstream", "wide", "--fault", "downstream_weak"],
        ["simulate", "--effect", "wall_film=nan"],
        ["simulate", "--fault", "gain_low=1.5"],
        ["simulate", "--fault", "sticky"],
        ["simulate", "--fault", "delay_symmetric=6"],  # the plant remembers 5 s
        ["simulate", "--fault", "downstream_delay_symmetric=6"],
        ["simulate", "--injection", "port", "--fault", "catalyst_low", "--format", "csv"],
        ["simulate", "--cycle", "nedc"],
        ["simulate", "--fault", "gain_low", "--fault-start", "1000", "--duration", "20"],
        ["simulate", "--fault", "gain_low", "--fault-start", "5000"],  # the cycle ends before
        ["simulate", "--fault", "catalyst_low", "--fault-start", "5"],  # bad from the start
        ["simulate", "--duration", "20", "--period", "0.2"],  # of a log
        ["simulate", "--duration", "0.005"],
        ["simulate", "--duration", "nan"],
    ],
)
def test_a_drive_that_cannot_be_simulated_is_refused(
    capsys: Capture, tmp_path: Path, arguments: list[str]
) -> None:
    from training import cli as train

    assert train.main([*arguments, "--out", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_run_on_a_silent_bus_says_that_nothing_came(capsys: Capture) -> None:
    assert cli.main(["run", "-i", "virtual", "-c", "silent", "--duration", "0.3"]) == 3
    assert "nothing was received" in capsys.readouterr().out
