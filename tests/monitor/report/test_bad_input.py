"""Bad input gets one clear line and exit code 2, or does no harm."""

import json
import subprocess
import sys
from pathlib import Path

import onnx
import pytest

import dbc
from monitor import cli
from monitor.frames.logs import read_frames
from monitor.model.model_file import metadata_of
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.conftest import ROOT
from tests.helpers.bad_logs import block, write_minute
from training.recordings.files.can_log import write_log


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give one minute of a simulated drive as a log."""
    return write_minute(tmp_path_factory.mktemp("drive"))


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


@pytest.mark.parametrize(
    ("suffix", "words"),
    [("log", "cut short after"), ("blf", "cut short: "), ("log.gz", "cut short after")],
)
def test_a_truncated_log_says_how_many_frames_came_before_it_is_noticed(
    capsys: pytest.CaptureFixture[str], drive: Path, tmp_path: Path, suffix: str, words: str
) -> None:
    whole = tmp_path / f"whole.{suffix}"
    write_log(whole, block(list(read_frames(drive))))
    cut = tmp_path / f"cut.{suffix}"
    cut.write_bytes(whole.read_bytes()[: int(whole.stat().st_size * 0.6) + 3])
    line = refused(capsys, "replay", cut)
    assert f"cut.{suffix}" in line
    assert words in line


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
    own = card | {"inputs": card["inputs"][:-1]}
    onnx.helper.set_model_props(edited, metadata_of(json.dumps(own)))
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
        ["simulate", "--downstream", "wide", "--fault", "downstream_weak"],
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


def test_a_run_on_a_silent_bus_ends_with_3_and_says_that_nothing_came(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["run", "-i", "virtual", "-c", "silent", "--duration", "0.3"]) == 3
    assert "nothing was received" in capsys.readouterr().out
