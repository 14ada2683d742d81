"""``o2mon dtc``: what the fault memory holds, for a person and as JSON."""

import json
from contextlib import closing
from pathlib import Path

import pytest

from monitor import cli
from monitor.memory import obd_records
from monitor.memory.dtc import Dtc
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import FreezeFrame
from monitor.memory.store import Memory
from tests.helpers.logs.injected_frames import HEALTHY

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def memory(tmp_path: Path) -> Path:
    path = tmp_path / "o2.db"
    store = DtcStore()
    for t_ns in (1_000_000_000, 1_780_000_000_000_000_000):
        store.start_driving_cycle()
        for dtc in store.fail("delay_rich_to_lean", t_ns, also=("slow_rich_to_lean",)):
            store.freeze(FreezeFrame(dtc.code, t_ns, {"engine_speed_rpm": 2100.0, "own": 3.5}))
    store.fail("biased_lean", 7)
    store.freeze(FreezeFrame("P2195", 2_500_000_000, {"lambda_measured": 1.125}))
    store.complete("range")
    store.report([obd_records.TestResult("response", "gain", 0.5, 0.76, 1.3)])
    store.report([obd_records.TestResult("bias", "offset", 1.703e-12, -0.065, 0.065)])
    store.counts.ignition_cycles += 1
    store.count_judged("response")
    store.count_general_denominator()
    store.drive(7200.0, 120.0)
    with closing(Memory(path)) as memory:
        memory.save(store.saved)
    return path


def output(capsys: Capture, *words: object) -> str:
    assert cli.main(["dtc", *map(str, words)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out


def test_the_codes_are_listed_with_states_and_counts(memory: Path, capsys: Capture) -> None:
    out = output(capsys, "list", "--memory", memory)
    lines = out.splitlines()
    said, others = lines[3:9], [*lines[:3], *lines[9:]]
    heads = ["P2195", "likely", "next", "P015A", "likely", "next"]
    assert [line.split(":")[0].strip() for line in said] == heads
    assert others == [
        "lamp ON, 2 codes",
        "  P2195  pending          0x27  biased_lean",
        "  P015A  confirmed  lamp  0xAF  delay_rich_to_lean or slow_rich_to_lean",
        "permanent: P015A",
        "since clearing: 0 warm-ups, 120.0 km, 2.0 h of engine running",
        "with the lamp on: 120.0 km, 2.0 h of engine running",
        "in all: 1 ignition cycle",
    ]
    result = json.loads(output(capsys, "list", "--memory", memory, "--json"))
    assert result["schema"] == "o2mon.dtc/1"
    assert result["mil"] is True
    assert result["permanent"] == ["P015A"]
    assert [d["code"] for d in result["dtcs"]] == ["P2195", "P015A"]
    assert result["dtcs"][1]["status"] == 0xAF
    assert "warning_indicator" in result["dtcs"][1]["status_bits"]
    assert result["counts"]["distance_since_clear_km"] == 120.0


def test_an_empty_memory_has_no_codes(tmp_path: Path, capsys: Capture) -> None:
    Memory(tmp_path / "o2.db").close()
    out = output(capsys, "list", "--memory", tmp_path / "o2.db")
    assert out.startswith("lamp off, 0 codes\n")
    assert "permanent" not in out
    assert output(capsys, "freeze-frame", "--memory", tmp_path / "o2.db") == "no freeze frames\n"


def test_freeze_frames_have_units_the_confirmed_code_first(memory: Path, capsys: Capture) -> None:
    lines = output(capsys, "freeze-frame", "--memory", memory).splitlines()
    assert [line.split() for line in lines] == [
        ["P015A", "2026-05-28", "20:26:40", "UTC"],
        ["engine_speed_rpm", "2100", "1/min"],
        ["own", "3.5"],
        ["P2195", "2.5", "s", "into", "the", "recording"],
        ["lambda_measured", "1.125", "-"],
    ]
    chosen = output(capsys, "freeze-frame", "P2195", "--memory", memory, "--json")
    (frame,) = json.loads(chosen)["freeze_frames"]
    assert frame == {"code": "P2195", "t_ns": 2_500_000_000, "values": {"lambda_measured": 1.125}}


def test_a_freeze_frame_that_is_not_there_names_those_there(memory: Path, capsys: Capture) -> None:
    assert cli.main(["dtc", "freeze-frame", "P0133", "--memory", str(memory)]) == 2
    assert "no freeze frame of P0133; there are: P015A, P2195" in capsys.readouterr().err


def test_readiness_shows_each_test_with_its_results(memory: Path, capsys: Capture) -> None:
    lines = output(capsys, "readiness", "--memory", memory).splitlines()
    by_test = {line.split()[0]: line for line in lines[:6]}
    assert " complete " in by_test["response"]
    assert "judged in 1 driving cycle, 1 were long and warm enough to count" in by_test["response"]
    assert " complete " in by_test["range"]
    assert " not complete " in by_test["activity"]
    (gain,) = [line for line in lines if "gain" in line]
    assert gain.endswith("outside")
    (offset,) = [line for line in lines if "offset" in line]
    assert offset.endswith(" 0   -0.065 to 0.065 lambda")
    assert "e-" not in offset  # what is nearly 0 is shown as 0
    result = json.loads(output(capsys, "readiness", "--memory", memory, "--json"))
    assert result["general_denominator"] == result["ignition_cycles"] == 1
    ready = {t["test"]: t["completed_since_clear"] for t in result["tests"]}
    assert [*ready] == ["response", "bias", "activity", "communication", "range", "ready"]
    assert [test for test in ready if ready[test]] == ["response", "bias", "range"]


def test_clearing_says_that_permanent_codes_stay(memory: Path, capsys: Capture) -> None:
    lines = output(capsys, "clear", "--memory", memory).splitlines()
    assert lines[0] == "cleared: P2195, P015A"
    assert lines[1].startswith("permanent codes stay: P015A;")
    with closing(Memory(memory)) as opened:
        saved = opened.load()
    assert all(dtc == Dtc(dtc.code) for dtc in saved.dtcs)
    assert dict(saved.permanent) == {"P015A": "delay_rich_to_lean"}
    assert saved.freeze_frames == ()
    again = json.loads(output(capsys, "clear", "--memory", memory, "--json"))
    assert again["cleared"] == []


@pytest.mark.parametrize("command", [("dtc", "clear"), ("replay", str(HEALTHY), "--quiet")])
def test_clearing_and_replaying_are_refused_while_a_monitor_runs_on_the_memory(
    command: tuple[str, ...], memory: Path, capsys: Capture
) -> None:
    with closing(Memory(memory, hold=True)):
        assert cli.main([*command, "--memory", str(memory)]) == 2
        assert "o2.db: the fault memory is in use by a running monitor" in capsys.readouterr().err
        assert "P015A" in output(capsys, "list", "--memory", memory)  # reading is allowed
    output(capsys, "clear", "--memory", memory)


@pytest.mark.parametrize("action", ["list", "freeze-frame", "readiness", "clear"])
def test_an_unusable_memory_is_exit_code_2(action: str, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "empty.db").touch()
    (tmp_path / "drive.log").write_text("(1.0) can0 123#00\n" * 100)
    for name, said in (
        ("nowhere.db", "no such fault memory"),
        ("empty.db", "is empty, a fault memory is wanted"),
        ("drive.log", "not a fault memory"),
    ):
        assert cli.main(["dtc", action, "--memory", str(tmp_path / name)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{tmp_path / name}: {said}" in line
    assert (tmp_path / "empty.db").stat().st_size == 0
    assert not (tmp_path / "nowhere.db").exists()
