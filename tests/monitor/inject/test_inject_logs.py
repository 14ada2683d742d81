"""Faults put into logs, tables and loggers' files by ``o2mon inject``."""

from pathlib import Path

import numpy as np
import pytest

import dbc
from monitor import cli
from monitor.base.errors import RecordingError
from monitor.base.files import manifest
from monitor.base.types import Frame
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks, read_frames
from monitor.grid.tables import read_table
from monitor.inject.injection import FRAME_FAULTS, NAMES, Injection
from monitor.memory.codes import CODES
from tests.helpers.drives.drive_tables import table
from tests.helpers.logs.bus_maps import OBD, values_of
from tests.helpers.logs.car_model import log_and_model
from tests.helpers.logs.injected_frames import (
    HEALTHY,
    MS,
    ROOT,
    decoded,
    injected,
    lambda_frames,
    write,
)
from tests.helpers.logs.logger_files import drive, write_text_table
from tests.helpers.logs.replays import replays

Capture = pytest.CaptureFixture[str]

SEVERITY = {"biased_lean": 0.2, "intermittent": 5.0}  # this vehicle's own offset is -0.03
WITHIN_S = {"intermittent": 180.0}
SCENARIOS = ROOT / "docs" / "scenarios"
SLOW = ("drift_lean", "drift_rich")  # in these minutes a drift is smaller than any limit
FOUND = [name for name in CODES if name in NAMES and name not in SLOW]


def inject(*words: str | Path) -> int:
    return cli.main(["inject", *map(str, words)])


@pytest.mark.parametrize("name", FOUND)
def test_a_healthy_drive_with_a_fault_put_on_has_the_code_of_the_fault(
    name: str, minutes: Path, ninety_seconds: Path, tmp_path: Path, capsys: Capture
) -> None:
    # GIVEN a scenario that expects every code of the fault, pending in the first drive
    scenario = tmp_path / "s.toml"
    severity = f"severity = {SEVERITY[name]}\n" if name in SEVERITY else ""
    expected = "".join(
        f'[[expect]]\ncode = "{code}"\nstate = "pending"\nwithin_s = {WITHIN_S.get(name, 120.0)}\n'
        for code in CODES[name]
    )
    scenario.write_text(f'[[fault]]\nname = "{name}"\n{severity}start_s = 20.0\n{expected}')
    # THEN it is met, and no other code came
    log = minutes if name in WITHIN_S else ninety_seconds
    assert inject(log, "--scenario", scenario, "--assert") == 0
    assert "NOT MET" not in capsys.readouterr().out


@pytest.mark.parametrize("name", ["noise", "drop_outs", *FRAME_FAULTS])
def test_disturbances_that_are_no_fault_of_the_sensor_raise_no_code(
    name: str, ninety_seconds: Path, tmp_path: Path
) -> None:
    scenario = tmp_path / "s.toml"
    scenario.write_text(f'[[fault]]\nname = "{name}"\n[[expect]]\ncode = "none"\n')
    assert inject(ninety_seconds, "--scenario", scenario, "--assert") == 0


@pytest.mark.parametrize("name", sorted(p.name for p in SCENARIOS.glob("*.toml")))
def test_the_shipped_scenarios_are_met(name: str, minutes: Path, capsys: Capture) -> None:
    scenario = SCENARIOS / name
    log = HEALTHY if name.startswith("offset") else minutes  # what is healthy takes longer
    assert inject(log, "--scenario", scenario, "--assert") == 0
    assert "  met" in capsys.readouterr().out


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".asc", ".blf", ".csv.gz", ".trc", ".mf4"])
def test_every_log_format_is_written_and_judged_alike(suffix: str, tmp_path: Path) -> None:
    frames = lambda_frames([1.0 + 0.2 * np.sin(n / 9) for n in range(500)])
    source, out = tmp_path / "in.log", tmp_path / f"out{suffix}"
    write(source, frames)
    assert inject(source, "--out", out, "--fault", "gain_low=0.5@2-8") == 0
    wanted = injected(frames, Injection("gain_low", 0.5, 2.0, 8.0))
    got = list(read_frames(out))
    assert [f.data for f in got] == [f.data for f in wanted]
    shifts = {(a.t_ns - b.t_ns) // 1000 for a, b in zip(got, wanted, strict=True)}
    assert max(shifts) - min(shifts) <= 1  # some formats keep no absolute time


def test_what_a_log_loses_is_said_and_a_log_of_no_frame_replaces_nothing(
    tmp_path: Path, capsys: Capture
) -> None:
    # GIVEN a log with a remote frame, an error frame and a line that is no frame
    source, out = write(tmp_path / "in.log", lambda_frames([1.0] * 300)), tmp_path / "out.log"
    lines = source.read_text().replace("vcan0", "can1").splitlines()
    lines[9:9] = ["(0.17) can1 0C2#R", "(0.17) can1 20000004#0000000000000000", "(0.17) can1 0C"]
    source.write_text("\n".join(lines) + "\n")
    assert inject(source, "-c", "can1", "--out", out) == 0
    assert sum(len(block.key) for block in read_blocks(out, channels=Channels("can1"))) == 300
    said = capsys.readouterr().out
    assert "error and remote frames 2" in said
    assert "1 line left out, the first: line 12" in said
    before = out.read_bytes()
    assert inject(source, "--out", out, "--force", "--fault", "signal_missing") == 2
    assert "no frame is left" in capsys.readouterr().err
    assert out.read_bytes() == before


def test_a_fault_acts_in_its_seconds_although_the_clock_of_the_log_is_set(
    ninety_seconds: Path, tmp_path: Path, capsys: Capture
) -> None:
    frames = list(read_frames(ninety_seconds))
    late = [*frames[:2000], *(f._replace(t_ns=f.t_ns + 10**18) for f in frames[2000:])]
    log, out = write(tmp_path / "set.log", late), tmp_path / "out.log"
    assert inject(log, "--out", out, "--fault", "biased_lean@20-25") == 0
    assert "clock_steps 1, rewritten 250" in capsys.readouterr().out
    _, (recording,) = replays(log)
    assert recording["counters"]["clock_steps"] == 1


def test_a_log_with_faults_stays_simulated_and_is_replaced_until_somebody_changes_it(
    tmp_path: Path, capsys: Capture
) -> None:
    # GIVEN a log that its manifest calls simulated
    source, out = write(tmp_path / "in.log", lambda_frames([1.0] * 50)), tmp_path / "out.log"
    told = {"file": "in.log", "source": "simulated", "sha256": manifest.sha256_of(source)}
    manifest.save(tmp_path, {"in.log": told})
    call = (source, "--out", out, "--fault")
    # THEN a fault is put on twice without a word, and the log is still said to be simulated
    assert [inject(*call, fault) for fault in ("noise", "gain_low=0.4")] == [0, 0]
    entry = manifest.entry_of(out)
    assert (entry["source"], entry["fault"], entry["severity"]) == ("simulated", "gain_low", 0.4)
    # WHEN it was edited THEN it is nobody's to replace
    out.write_text(out.read_text() + "(9.0) vcan0 123#00\n")
    assert inject(*call, "noise") == 2
    assert "out.log: is there already; --force replaces it" in capsys.readouterr().err


def test_the_frames_of_several_drives_go_to_numbered_logs(tmp_path: Path) -> None:
    source, scenario = tmp_path / "in.log", tmp_path / "s.toml"
    write(source, lambda_frames([1.1] * 100))
    scenario.write_text('drives = 2\n[[fault]]\nname = "stuck_at_one"\ndrives = [2]\n')
    out = tmp_path / "out.log.gz"
    assert inject(source, "--scenario", scenario, "--out", out) == 0
    first, second = (tmp_path / f"out_{n}.log.gz" for n in (1, 2))
    means = [np.mean(decoded(list(read_frames(path)))) for path in (first, second)]
    assert means == pytest.approx([1.1, 1.0], abs=1e-3)
    first.unlink()  # AND a file of another in the second's place is found before that is written
    second.write_bytes(b"mine")
    assert inject(source, "--scenario", scenario, "--out", out) == 2
    assert not first.exists() and second.read_bytes() == b"mine"


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["IN"], "nothing to do with LOG"),
        (["IN", "--out", "OUT", "--assert"], "--assert needs a --scenario"),
        (["IN", "--out", "out.txt"], "unknown log format '.txt'"),
        (["IN", "--out", "no/such/out.log"], "no/such/out.log: the folder does not exist"),
        (["IN", "--out", "OUT", "-i", "virtual", "-c", "a"], "-i/--interface is for a bus"),
        (["IN", "--out", "OUT", "--bitrate", "500000"], "--bitrate is for a bus, not"),
        (["IN", "--out", "OUT", "--to-interface", "virtual"], "--to-interface is for a bus"),
        (["none.log", "--out", "OUT"], "none.log: cannot read it"),
        (["-i", "virtual", "-c", "a"], "give the other side"),
        (["-i", "virtual", "-c", "a", "--to-channel", "a"], "both sides are virtual a"),
        (
            ["-i", "virtual", "-c", "a", "--to-channel", "b", "--out", "OUT"],
            "--out is for a CAN log",
        ),
        (["-i", "udp_multicast", "-c", "239.1.1.1", "--to-channel", "239.1.1.2"], "hears what it"),
        (["CAN_INTERFACE=udp_multicast", "-c", "a", "--to-channel", "b"], "hears what it"),
        (["-i", "virtual", "CAN_CHANNEL=a", "--to-channel", "a"], "both sides are virtual a"),
        (["IN", "--out", "OUT", "--dbc", "x.dbc"], "--dbc and --map come in pairs"),
        (["IN", "--out", "OUT", "--scenario", "S", "--junit", "XML"], "what --assert finds; give"),
        (["IN", "--out", "OUT", "--scenario", "S", "S"], "several scenarios are for a LOG"),
        (["IN", "--out", "OUT", "--scenario", "S", "S", "--assert"], "several scenarios are for a"),
    ],
)
def test_what_cannot_be_is_refused_with_exit_code_2(
    argv: list[str], says: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    for word in (word for word in argv if word.startswith("CAN_")):  # of the environment
        monkeypatch.setenv(*word.split("="))
    write(tmp_path / "in.log", lambda_frames([1.0] * 3))
    names = {"IN": "in.log", "OUT": "out.log", "XML": "report.xml"}
    paths = {word: str(tmp_path / name) for word, name in names.items()}
    paths["S"] = str(SCENARIOS / "silent_ecu.toml")
    assert inject(*(paths.get(arg, arg) for arg in argv if arg[:4] != "CAN_")) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize("is_alone", [True, False])
def test_answers_under_29_bits_are_changed_as_those_under_11(
    is_alone: bool, tmp_path: Path
) -> None:
    # GIVEN a log of lambda by PID 34 from an engine with 29-bit diagnostics, and from one with 11
    maps = ["--dbc", str(dbc.path("obd2.dbc")), "--map", str(dbc.path("obd2.toml"))]
    answers = [bytes.fromhex(f"064134{0x7000 + 0x100 * n:04X}800000") for n in range(20)]
    if not is_alone:  # lambda between engine speed and vehicle speed, in two frames
        parts = ("100B410C1AF834{:02X}", "210080000D500000")
        answers = [bytes.fromhex(p.format(0x70 + n)) for n in range(20) for p in parts]
    for name, key, long in (("11.log", 0x7E8, False), ("29.log", 0x18DAF110, True)):
        write(tmp_path / name, [Frame(n * 100 * MS, key, long, a) for n, a in enumerate(answers)])
        out = tmp_path / f"out{name}"
        assert inject(tmp_path / name, "--fault", "biased_lean", "--out", out, *maps) == 0
    # THEN the same readings come out under the ECU's identifiers, and not the ECU's
    short, long_ = (list(read_frames(tmp_path / f"out{n}.log")) for n in (11, 29))
    assert len(short) == (20 if is_alone else 60)
    assert long_ == [f._replace(can_id=0x18DAF110, is_extended=True) for f in short]
    assert values_of(OBD, "lambda_measured", short)[-1] == pytest.approx(1.1234, abs=1e-3)


def columns(path: Path) -> dict[str, np.ndarray]:
    read = read_table(path)
    return dict(zip(read.names, read.values.T, strict=True))


def test_a_table_with_a_late_sensor_has_the_code_of_a_late_sensor(
    tmp_path: Path, capsys: Capture
) -> None:
    # GIVEN a healthy table, and a scenario whose sensor is late from 60 s on
    healthy, late = table(tmp_path / "drive.csv"), tmp_path / "late.csv"
    scenario = tmp_path / "late.toml"
    scenario.write_text(
        '[[fault]]\nname = "delay_rich_to_lean"\nstart_s = 60.0\n'
        '[[expect]]\ncode = "P015A"\nwithin_s = 120.0\n'
    )
    assert inject(healthy, "--scenario", scenario, "--assert", "--out", late) == 0
    assert "P015A pending (delay_rich_to_lean)" in capsys.readouterr().out
    # THEN the written table has the same verdict, and only lambda differs, from 60 s on
    assert cli.main(["replay", str(late)]) == 1
    assert "P015A delay_rich_to_lean" in capsys.readouterr().out
    before, after = columns(healthy), columns(late)
    for name, values in before.items():
        same = np.isclose(values, after[name], rtol=1e-6, equal_nan=True)
        assert same[: 600 if name == "lambda_measured" else None].all(), name
    assert not np.isclose(before["lambda_measured"], after["lambda_measured"])[600:].all()


def cold_log(folder: Path, n_cold: int) -> tuple[Path, np.ndarray]:
    """Write a logger's file with its profile beside it; return it and the AFR, 22.3 while cold."""
    own = drive(400)
    own["afr"][:n_cold] = 22.3  # the controller's value for a cold sensor
    (folder / "own.toml").write_text(
        'time = "Time"\n[[recognise]]\ncolumns = ["Time", "RPM", "AFR"]\n'
        '[signals]\nengine_speed_rpm = "RPM"\n'
        'lambda_measured = { column = "AFR", unit = "AFR", pinned = [22.3] }\n'
    )
    cells = {"Time": own["t_s"], "RPM": own["rpm"], "AFR": own["afr"]}
    return write_text_table(folder / "drive.csv", cells), own["afr"]


def test_a_logger_s_file_becomes_a_table_that_is_read_as_the_log(tmp_path: Path) -> None:
    log, afr = cold_log(tmp_path, 50)
    out = tmp_path / "out.csv"
    assert inject(log, "--out", out, "--fault", "biased_lean=0.1") == 0
    moved = columns(out)["lambda_measured"] - afr / 14.7
    assert moved[:50] == pytest.approx(np.zeros(50), abs=1e-6)
    assert moved[50:] == pytest.approx(np.full(350, 0.1), abs=1e-4)
    # THEN what is pinned stays so, and a model of another car is no hindrance
    read = read_table(out)
    assert read.profile == "own"
    assert read.pinned is not None
    assert np.flatnonzero(read.pinned.any(axis=1)).tolist() == list(range(50))
    assert [cli.main(["replay", str(path)]) for path in (log, out)] == [3, 3]
    assert [cli.main(["check", str(path)]) for path in (log, out)] == [0, 0]
    # AND a manifest that was spoilt by hand is named
    entries = manifest.load(tmp_path)
    entries[out.name]["pinned"] = {"lambda_measured": [[1.5], "x"]}
    manifest.save(tmp_path, entries)
    with pytest.raises(RecordingError, match=r"manifest\.json: pinned of out\.csv: a list of num"):
        read_table(out)
    (tmp_path / manifest.NAME).write_text("{}")  # another program's
    assert not read_table(out).profile


def test_a_fault_that_changes_nothing_meets_no_expectation(tmp_path: Path, capsys: Capture) -> None:
    # GIVEN a logger's drive whose sensor is cold for 20 s, and a fault of 30 s and of 15 s
    log, _ = cold_log(tmp_path, 200)
    scenario = tmp_path / "cold.toml"
    for end_s, code in ((30.0, 0), (15.0, 1)):
        scenario.write_text(
            f'[[fault]]\nname = "biased_lean"\nend_s = {end_s}\n'
            '[[expect]]\ncode = "none"\njudged = false\n'
        )
        # WHEN it is asserted, without a model of the car THEN a fault that acts is wanted
        assert inject(log, "--scenario", scenario, "--assert") == code
    assert "a fault that changes something  nothing changed" in capsys.readouterr().out


def test_a_sensor_that_is_not_ready_leaves_blanks_and_says_so(tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    healthy = table(tmp_path / "drive.csv")
    assert inject(healthy, "--out", out, "--fault", "not_ready@100-110") == 0
    after = columns(out)
    blank = np.isnan(after["lambda_measured"]) & ~np.isnan(columns(healthy)["lambda_measured"])
    assert (np.flatnonzero(blank) == np.arange(1000, 1100)).all()
    assert (after["sensor_ready"][1000:1100] == 0.0).all()


def test_a_fault_is_put_on_a_log_that_only_the_model_of_its_car_knows(tmp_path: Path) -> None:
    # GIVEN a log of a car whose model reads a column without a canonical name
    own = drive(400)
    log, model = log_and_model(tmp_path, own)
    out = tmp_path / "out.csv"
    given = (log, "--out", out, "--fault", "biased_lean=0.1")
    assert inject(*given) == 2
    assert inject(*given, "--model", model) == 0
    # THEN the table has lambda with the fault, and the model's own column
    assert columns(out)["lambda_measured"] == pytest.approx(own["afr"] / 14.7 + 0.1, abs=1e-4)
    assert columns(out)["Luft"] == pytest.approx(own["map_kpa"], abs=1e-4)


def test_a_column_whose_name_has_a_comma_stays_one_column(tmp_path: Path) -> None:
    log, out = tmp_path / "drive.csv", tmp_path / "out.csv"
    log.write_text('time_s,lambda_measured,"boost, kPa"\n0.0,1.0,2.0\n0.1,,3.0\n0.2,1.1,4.0\n')
    assert inject(log, "--out", out, "--fault", "biased_lean=0.1") == 0
    after = columns(out)
    assert after["boost, kPa"].tolist() == [2.0, 3.0, 4.0]
    assert after["lambda_measured"] == pytest.approx([1.1, np.nan, 1.2], nan_ok=True)


@pytest.mark.parametrize(
    ("name", "out", "message"),
    [
        ("frame_loss", "out.csv", "frame_loss is a fault of frames, this is a table"),
        ("signal_missing", "out.csv", "signal_missing is a fault of frames, this is a table"),
        ("signal_invalid", "out.csv", "signal_invalid is a fault of frames, this is a table"),
        ("gain_low=0.5@9999", "out.csv", "gain_low=0.5 from 9999 s: begins after the drive's end"),
        ("gain_low", "out.log", "out.log: a changed table is written as .csv"),
        ("gain_low", "drive.csv", "is read, too; choose another file to write"),
    ],
)
def test_what_a_table_cannot_have_is_refused(
    name: str, out: str, message: str, tmp_path: Path, capsys: Capture
) -> None:
    healthy = table(tmp_path / "drive.csv")
    assert inject(healthy, "--out", tmp_path / out, "--fault", name) == 2
    assert message in capsys.readouterr().err


def test_a_silent_ecus_bus_is_named_and_cannot_be_judged(capsys: Capture) -> None:
    buses = ("-i", "virtual", "-c", "silent", "--to-channel", "tester", "--duration", "0.1")
    assert inject(*buses, "--scenario", SCENARIOS / "silent_ecu.toml", "--assert") == 2
    assert "o2mon: virtual silent: no frame came from the ECU" in capsys.readouterr().err
