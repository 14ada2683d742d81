"""Logs of frames as recordings, and a log of two buses in every command that reads."""

import math
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from asammdf import MDF, Signal
from cantools.database import can
from hypothesis import given
from hypothesis import strategies as st

import dbc
from monitor.base.errors import O2Error, RecordingError, SignalMapError, UsageError
from monitor.base.signals import OWN
from monitor.base.types import Quality
from monitor.cli import main as o2mon
from monitor.decode.bus_map import load_pairs
from monitor.decode.signal_map import Integrity
from monitor.frames.blocks import frames_of
from monitor.frames.logs import read_frames
from monitor.frames.tables.readers import open_table
from tests.helpers.examples import inputs
from tests.helpers.logs.bus_maps import Decoding, values_of
from training.cli import _parser
from training.cli import main as o2train
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.recordings.files.can_encoding import encode_message
from training.recordings.files.can_log import block_of, broadcast, outgoing, write_log
from training.recordings.recording import load, write_table

ECU = load_pairs([(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))])
T_NS = np.arange(50, dtype=np.int64) * 100_000_000


def a_drive(n: int = 50) -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    rng = np.random.default_rng(7)
    return {
        signal.name: rng.integers(0, 2, n).astype(float)
        if signal.role == "enable"
        else rng.uniform(signal.minimum, signal.maximum, n)
        for signal in OWN
    }


@inputs(50)
@given(data=st.data())
def test_the_vectorised_encoding_agrees_with_cantools(data: st.DataObject) -> None:
    each = data.draw(st.sampled_from(outgoing(ECU)))
    names = [c.signal.name for c in each.channels]
    raw = {
        c.signal.name: data.draw(st.integers(0, (1 << c.signal.length) - 2)) for c in each.channels
    }
    physical = {
        c.signal.name: np.array([raw[c.signal.name] * float(c.signal.scale) + c.signal.offset])
        for c in each.channels
    }
    count = data.draw(st.integers(0, 15))
    payload = encode_message(each.message, each.integrity, physical, 1, count)[0].tobytes()
    decoded = each.message.decode(payload, scaling=False, decode_choices=False)
    assert isinstance(decoded, dict)
    assert {name: decoded[name] for name in names} == raw
    assert decoded["AliveCounter"] == count


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("sign", ["+", "-"])
def test_both_byte_orders_and_signs_are_encoded(tmp_path: Path, order: int, sign: str) -> None:
    path, map_path = tmp_path / "own.dbc", tmp_path / "own.toml"
    start = 3 if order else 8 * 1 + 5
    layout = f' SG_ X : {start}|11@{order}{sign} (1,0) [0|0] "" A'
    path.write_text(f'VERSION ""\n\nBU_: A\n\nBO_ 100 M: 5 A\n{layout}\n')
    map_path.write_text('[signals.x]\nmessage = "M"\nsignal = "X"\n')
    bus_map = load_pairs([(path, map_path)])
    values = np.array([0.0, 1.0, 700.0, -3.0 if sign == "-" else 5.0, 1e9])
    (each,) = outgoing(bus_map)
    payloads = each.encode({"x": values}, len(values))
    assert payloads.shape == (5, 5)
    frames = block_of(each.message, np.arange(5), payloads)
    top = 1023.0 if sign == "-" else 2047.0
    assert values_of(bus_map, "x", list(frames_of(frames))) == [*values[:4], top]


def test_what_the_table_lacks_or_leaves_blank_is_sent_as_not_available() -> None:
    values = {"lambda_measured": np.full(50, math.nan)}
    found = Decoding(ECU, ECU.names).push(list(frames_of(broadcast(ECU, T_NS, values))))
    assert all(each and all(map(math.isnan, each.values())) for each in found)


def test_a_missing_value_of_64_bits_without_a_sign_is_sent_as_not_available() -> None:
    message = can.Message(256, "M", 8, [can.Signal("X", 0, 64)])
    payloads = encode_message(message, Integrity(not_available="all_ones"), {}, 1)
    assert payloads.tolist() == [[255] * 8]


def test_messages_keep_their_cycle_and_counters_run_on() -> None:
    frames = broadcast(ECU, T_NS, a_drive(), start_ns=1_000_000_000)
    for each in outgoing(ECU):
        mine = frames.t_ns[frames.key == each.message.frame_id]
        assert mine[0] == 1_000_000_000
        assert set(np.diff(mine).tolist()) == {each.cycle_ns}
    assert np.all(np.diff(frames.t_ns) >= 0)


def test_a_map_without_the_tables_signals_is_refused() -> None:
    with pytest.raises(SignalMapError, match="carries none of the table's signals other"):
        broadcast(ECU, T_NS, {"other": np.zeros(50)})


def test_the_groups_of_a_multiplexed_message_are_sent_in_turn_and_read_back() -> None:
    # GIVEN a database with all signals in one message that its multiplexers switch
    obd = load_pairs([(dbc.path("obd2.dbc"), dbc.path("obd2.toml"))])
    values = {"coolant_temperature_degc": 85.0, "engine_speed_rpm": 2000.0, "maf_kg_h": 72.0}
    table = {name: np.full(50, value) for name, value in values.items()}
    # WHEN a table is sent
    frames = list(frames_of(broadcast(obd, T_NS, table)))
    # THEN every frame carries one group, and each value comes back
    seen = dict.fromkeys(values, 0)
    for found in Decoding(obd, tuple(values)).push(frames):
        for name, value in (found or {}).items():
            assert value == pytest.approx(values[name], abs=0.5)
            seen[name] += 1
    assert min(seen.values()) > 10
    groups = outgoing(obd)
    assert len(groups) > 10
    assert {each.n_turns for each in groups} == {len(groups)}
    assert max(seen.values()) * len(groups) <= len(frames) + len(groups)


@pytest.mark.parametrize("name", ["drive.txt", "drive.blf.gz", "missing/drive.log"])
def test_a_log_that_cannot_be_written_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(O2Error, match=name):
        write_log(tmp_path / name, broadcast(ECU, T_NS, a_drive()))


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet"])
def test_tables_are_written_reproducibly_and_read_back(tmp_path: Path, suffix: str) -> None:
    t_s = np.linspace(0.0, 0.4, 5)
    values = np.array([[1.0, math.nan], [0.1 + 0.2, 2.0], [3.0, 1e-9], [4.0, 5.0], [5.0, 6.0]])
    paths = [tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"]
    for path in paths:
        write_table(path, t_s, ["x", "y"], values)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    got = load(paths[0])
    np.testing.assert_array_equal(got.values, values)
    assert got.quality[0].tolist() == [Quality.GOOD, Quality.INVALID]
    assert got.names == ("x", "y")
    np.testing.assert_allclose(got.t_s, t_s, atol=1e-9)


def test_unusable_tables_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"t\.xls: unknown table format"):
        write_table(tmp_path / "t.xls", np.zeros(1), ["x"], np.zeros((1, 1)))
    with pytest.raises(UsageError, match="cannot write it"):
        write_table(tmp_path / "missing" / "t.csv", np.zeros(1), ["x"], np.zeros((1, 1)))
    path = tmp_path / "t.parquet"
    path.write_bytes(b"nonsense")
    with pytest.raises(RecordingError, match=r"t\.parquet: cannot read the table"):
        load(path)
    pl.DataFrame({"time_s": [0.0], "x": ["word"]}).write_parquet(path)
    with pytest.raises(RecordingError, match="column x holds no numbers"):
        load(path)
    for period_s in (-1.0, 0.0, math.nan, math.inf):
        with pytest.raises(UsageError, match="sample period"):
            load(path, period_s=period_s)


def test_a_log_of_other_frames_than_the_map_s_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.log"
    path.write_text("".join(f"({0.01 * i:.2f}) can0 7A1#0011\n" for i in range(100)))
    with pytest.raises(RecordingError, match=r"other\.log: no frame holds a good value of "):
        load(path)


def test_a_recording_read_otherwise_is_another_one(tmp_path: Path) -> None:
    path, columns = tmp_path / "t.csv", tmp_path / "columns.toml"
    write_table(path, np.arange(3) * 0.1, ["AFR"], np.full((3, 1), 14.7))
    read = []
    for factor in (1 / 14.7, 1 / 14.7, 1 / 14.0):
        columns.write_text(f'lambda_measured = {{ column = "AFR", factor = {factor} }}')
        read.append(load(path, columns=columns))
    first, same, other = read
    assert first.read_sha256 == same.read_sha256 != other.read_sha256
    assert first.sha256 == other.sha256


def measurement(path: Path, rasters: dict[str, float], unit: str = "-") -> None:
    with MDF(version="4.10") as mdf:
        for name, step_s in rasters.items():
            t_s = np.arange(0, 5, step_s)
            mdf.append(Signal(samples=np.floor(t_s), timestamps=t_s, name=name, unit=unit))
        mdf.save(path)


def test_a_measurement_file_at_several_rasters_is_brought_to_one_grid(tmp_path: Path) -> None:
    path = tmp_path / "m.mf4"
    measurement(path, {"Lam": 0.01, "Temp": 1.0})
    columns = tmp_path / "channels.toml"
    columns.write_text(
        'lambda_measured = { column = "Lam", factor = 0.1, offset = 1.0 }\n'
        'coolant_temperature_degc = "Temp"\n'
    )
    got = load(path, columns=columns)
    assert got.names == ("lambda_measured", "coolant_temperature_degc")
    assert got.period_ns == 100_000_000
    assert len(got.t_s) == 49
    assert np.all(got.quality == Quality.GOOD)
    assert got.column("lambda_measured")[25] == pytest.approx(1.2)
    with pytest.raises(RecordingError, match="has no channel maf_kg_h"):
        load(path, ["maf_kg_h"], columns=columns)


def test_a_measurement_file_at_one_raster_is_used_sample_for_sample(tmp_path: Path) -> None:
    path = tmp_path / "m.mf4"
    measurement(path, {"a": 0.02, "b": 0.02})
    got = load(path)
    assert (got.names, got.period_ns, len(got.t_s)) == (("a", "b"), 20_000_000, 250)


def test_the_unit_of_a_channel_is_converted_or_refused(tmp_path: Path) -> None:
    path, columns = tmp_path / "m.mf4", tmp_path / "channels.toml"
    columns.write_text('coolant_temperature_degc = "tmot"\n')
    measurement(path, {"tmot": 0.1}, "degF")
    assert load(path, columns=columns).column("coolant_temperature_degc")[0] == pytest.approx(
        -17.78, abs=0.01
    )
    measurement(tmp_path / "other.mf4", {"tmot": 0.1}, "kPa")
    with pytest.raises(
        RecordingError, match=r"'tmot' has the unit kPa, one of coolant_.* \(degC\)"
    ):
        load(tmp_path / "other.mf4", columns=columns)


def test_the_monitor_says_how_to_read_a_measurement_file(tmp_path: Path) -> None:
    path = tmp_path / "m.mf4"
    measurement(path, {"a": 0.02})
    with pytest.raises(RecordingError, match=r"no CAN frames in the log; 'o2train table' writes"):
        list(read_frames(path))
    with pytest.raises(RecordingError, match=r"not a table; 'o2train table' reads \.mf4"):
        open_table(path)


def run(*words: object) -> int:
    given = [str(word) for word in words]
    args = _parser(given).parse_args(given)
    code: int = args.func(args)
    return code


def test_log_and_table_undo_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, log, back = tmp_path / "a.csv", tmp_path / "a.asc", tmp_path / "b.parquet"
    names = ["lambda_measured", "maf_kg_h"]
    rows = np.repeat([[1.0, 20.0], [1.5, 30.0]], 25, axis=0)
    write_table(table, T_NS / 1e9, names, rows)
    assert run("log", table, "--out", log) == 0
    assert run("table", log, "--out", back, "--signals", *names) == 0
    got = load(back)
    assert got.names == tuple(names)
    np.testing.assert_allclose(got.values[[5, 40]], [[1.0, 20.0], [1.5, 30.0]])
    assert "1000 frames" in capsys.readouterr().out


def test_a_table_whose_times_are_milliseconds_makes_no_log_of_weeks(tmp_path: Path) -> None:
    # GIVEN six seconds of a drive, its times in ms
    table, log, columns = tmp_path / "a.csv", tmp_path / "a.log", tmp_path / "columns.toml"
    write_table(table, np.arange(60) * 100.0, ["maf_kg_h"], np.full((60, 1), 20.0))
    # WHEN it is to become a log, THEN what to give is said
    with pytest.raises(RecordingError, match=r"a\.csv: rows are 100 s apart.* factor = 0\.001"):
        run("log", table, "--out", log)
    columns.write_text('time_s = { column = "time_s", factor = 0.001 }')
    assert run("log", table, "--out", log, "--columns", columns) == 0
    for start in ("nan", "1e30", "-1"):
        with pytest.raises(UsageError, match="--start"):
            run("log", table, "--out", log, f"--start={start}")


def test_a_measurement_file_of_values_too_far_apart_is_refused(tmp_path: Path) -> None:
    with MDF(version="4.10") as mdf:
        mdf.append(Signal(np.arange(5.0), 100.0 * np.arange(5), name="maf_kg_h", unit="kg/h"))
        mdf.save(tmp_path / "m.mf4")
    with pytest.raises(RecordingError, match=r"m\.mf4: rows are 100 s apart, at most 60 s"):
        load(tmp_path / "m.mf4")


MODEL = str(Path(dbc.__file__).parents[1] / "monitor" / "model" / "shipped.onnx")


@pytest.fixture(scope="module")
def two_buses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a drive on can0 with other frames of the same identifiers on can1."""
    folder = tmp_path_factory.mktemp("two")
    lines = write(Experiment(duration_s=30.0), folder, "log").read_text().splitlines()
    (name,) = {line.split()[1] for line in lines}
    other = [f"{line.replace(name, 'can1').split('#')[0]}#0000000000000000" for line in lines]
    both = "\n".join(v for pair in zip(lines, other, strict=True) for v in pair)
    path = folder / "both" / "two.log"
    path.parent.mkdir()
    path.write_text(both.replace(f" {name} ", " can0 ") + "\n")
    return path


@pytest.mark.parametrize(
    "command",
    [
        "o2mon inject LOG --out OUT.log --fault gain_low=0.5",
        f"o2mon map {dbc.path('o2_ecu.dbc')} --log LOG --out OUT.toml",
        "o2mon check LOG",
        "o2train table LOG --out OUT.csv",
        "o2train check LOG",
    ],
)
def test_a_command_refuses_a_mixture_of_buses_and_reads_the_named_one(
    two_buses: Path, tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = command.replace("LOG", str(two_buses)).replace("OUT", str(tmp_path / "out")).split()
    main = {"o2mon": o2mon, "o2train": o2train}[words[0]]
    assert main(words[1:]) == 2
    assert "is on the channels 'can0' and 'can1'" in "".join(capsys.readouterr())
    assert main([*words[1:], "--channel", "can7"]) == 2
    assert "no channel can7" in "".join(capsys.readouterr())
    assert main([*words[1:], "--channel", "can0"]) in (0, 2, 3)
    said = "".join(capsys.readouterr())
    assert "is on the channels" not in said and "has no channel" not in said
    for out in tmp_path.glob("out.*"):
        assert "can1" not in out.read_text()


def test_a_fleet_reads_the_named_channel(two_buses: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(two_buses.parent, tmp_path / "drives")
    words = ["fleet", str(folder), "--model", MODEL, "--jobs", "1", "--out"]
    mixed, chosen = tmp_path / "mixed.parquet", tmp_path / "chosen.parquet"
    o2train([*words, str(mixed)])
    o2train([*words, str(chosen), "--channel", "can0"])
    errors = [pl.read_parquet(path)["error"][0] for path in (mixed, chosen)]
    assert "is on the channels 'can0' and 'can1'" in errors[0]
    assert not errors[1]
