"""Which records a drive gives, and how they are written."""

import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor import cli
from monitor.base.errors import UsageError
from monitor.base.signals import BY_NAME
from monitor.sinks.address import open_sink, shown
from monitor.sinks.record import FIELDS, Record, Value, json_of
from tests.conftest import ROOT

SHIPPED = ROOT / "monitor" / "model" / "shipped.onnx"
Told = tuple[list[dict[str, Any]], dict[str, Any]]  # records of a drive, and its entry in the JSON
LATE = next((ROOT / "replay_logs").glob("delay_rich_to_lean_*.blf"))


def replayed(out: Path, *options: str) -> list[dict[str, Any]]:
    cli.main(["replay", str(LATE), "--quiet", "--sink", f"jsonl:{out}", *options])
    return [json.loads(line) for line in out.read_text().splitlines()]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Told:
    folder = tmp_path_factory.mktemp("lines")
    records = replayed(folder / "out.jsonl", "--json", str(folder / "out.json"))
    return records, json.loads((folder / "out.json").read_text())["recordings"][0]


def test_a_late_sensor_is_a_verdict_of_windows_of_fuel_cuts_and_one_code(drive: Told) -> None:
    records, recording = drive
    [dtc] = recording["dtcs"]
    assert dtc["fault"] == "delay_rich_to_lean"
    assert {name for each in records for name in each} <= FIELDS | BY_NAME.keys()  # for no tag
    verdicts = [each for each in records if each["kind"] == "verdict"]
    for of in ("window", "fuel_cut"):
        own = [each for each in verdicts if each["of"] == of]
        assert own[-1]["verdict"] == "failed"
        assert all(each["fault"] in ("", "delay_rich_to_lean") for each in own)
        assert all(a["verdict"] != b["verdict"] for a, b in pairwise(own))  # changes alone
    (code,) = (each for each in records if each["kind"] == "code")
    assert code["code"] == dtc["code"]
    assert (code["state"], code["status"]) == (dtc["state"], dtc["status"])


def test_signals_come_once_a_second_and_lambda_is_prediction_plus_residual(drive: Told) -> None:
    signals = [each for each in drive[0] if each["kind"] == "signals"]
    assert {round((b["t_ns"] - a["t_ns"]) / 1e9, 6) for a, b in pairwise(signals)} == {1.0}
    names = ("lambda_measured", "predicted", "residual")
    steady = [[each[name] for name in names] for each in signals if "residual" in each]
    assert len(steady) > 300
    fitting = [abs(m - p - r) < 1e-6 for m, p, r in steady]
    assert sum(fitting) > 0.98 * len(fitting)  # not where a value is missing within the second
    assert {each["dtcs"] for each in signals} == {0, 1}
    assert 500.0 < signals[-1]["engine_speed_rpm"] < 4000.0


@pytest.mark.parametrize("name", ["kind", "fault", "engine_speed_rpm"])
def test_a_tag_with_the_name_of_a_record_s_own_field_is_refused(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["replay", str(LATE), "--sink", "jsonl:-", "--sink-tag", f"{name}=17"]
    with pytest.raises(SystemExit, match="2"):
        cli.main(call)
    assert f"--sink-tag: {name}=17: records have a {name} of their own" in capsys.readouterr().err


def test_tags_are_the_user_s_and_signals_come_no_more_often_than_wanted(tmp_path: Path) -> None:
    records = replayed(tmp_path / "out.jsonl", "--sink-rate", "4", "--sink-tag", "vehicle=17")
    assert {each["vehicle"] for each in records} == {"17"}
    times_ns = [each["t_ns"] for each in records if each["kind"] == "signals"]
    assert {b - a for a, b in pairwise(times_ns)} == {300_000_000}


def test_records_are_printed_as_lines_where_the_address_is_a_dash(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    page = str(tmp_path / "page.html")
    assert cli.main(["replay", str(LATE), "--sink", "jsonl:-", "--html", page]) == 1
    kinds = {json.loads(line)["kind"] for line in capfd.readouterr().out.splitlines()}
    assert kinds == {"signals", "verdict", "code"}


def test_a_replay_says_which_sink_takes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["replay", str(LATE), "--quiet", "--sink", "jsonl:/dev/full"]) == 2
    assert "--sink jsonl:/dev/full fails: " in capsys.readouterr().err


def test_an_address_without_a_sink_is_a_usage_error() -> None:
    for address, said in (
        ("kafka://user:secret@b/t", "--sink kafka://b/t: no such kind; there are jsonl, mq"),
        ("mqtt:/x", "--sink mqtt:/x: an MQTT sink needs a host"),
        ("jsonl://host/a.jsonl", "jsonl:FILE"),
        ("mqtt://host:many", "Port"),
    ):
        with pytest.raises(UsageError, match=said):
            open_sink(address, {})


@pytest.mark.parametrize("name", ["car #1.jsonl", "why?.jsonl", "ä %20.jsonl"])
@pytest.mark.parametrize("torn", ["", '{"kind": "cyc'])
def test_lines_go_to_the_file_of_the_address_behind_one_that_a_kill_tore(
    tmp_path: Path, name: str, torn: str
) -> None:
    (tmp_path / name).write_text(torn)
    record = Record("cycle", 5, {"started": True})
    sink = open_sink(f"jsonl:{tmp_path / name}", {})
    sink.write([record])
    sink.close()
    (out,) = tmp_path.iterdir()
    assert out.read_text().splitlines() == [*torn.splitlines(), json_of(record, {})]


def test_lines_are_never_appended_to_a_file_of_anything_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, new = tmp_path / "drive.blf", tmp_path / "new"
    log.write_bytes(LATE.read_bytes())
    for sink, more in ((log, ()), (SHIPPED, ()), (new, ("--json", str(new)))):
        call = ["replay", str(log), "--sink", f"jsonl:{sink}", *more]
        assert cli.main(call) == 2
        assert str(sink) in capsys.readouterr().err
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="is there already and holds no records"):
        open_sink(f"jsonl:{tmp_path / 'notes.txt'}", {})
    assert log.read_bytes() == LATE.read_bytes()


def test_no_message_shows_a_password() -> None:
    assert shown("mqtts://user:secret@host:8883/car?p=secret") == "mqtts://host:8883/car"
    with pytest.raises(UsageError, match=r"^--sink mqtt://user: a topic .* has no \+ and no #$"):
        open_sink("mqtt://user#1:secret@host/car", {})  # the # is not escaped


@given(
    tags=st.dictionaries(st.text(max_size=8), st.text(max_size=8), max_size=3),
    values=st.dictionaries(
        st.text(max_size=8).filter(lambda name: name not in ("kind", "t_ns")),
        st.floats(-1e9, 1e9) | st.booleans() | st.integers() | st.text(max_size=8),
    ),
)
def test_any_text_stays_in_its_line(tags: Mapping[str, str], values: Mapping[str, Value]) -> None:
    line = json_of(Record("signals", 5, values), tags)
    assert len(line.splitlines()) == 1
    read = json.loads(line)
    assert read.keys() == {"kind", "t_ns", *tags, *values}
    for name, value in values.items():
        is_text = isinstance(value, str)
        assert read[name] == (value if is_text else pytest.approx(value, rel=1e-8))
