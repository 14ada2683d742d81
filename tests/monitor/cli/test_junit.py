"""JUnit XML of drives and scenarios, as a CI server reads it."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from monitor import cli
from monitor.base.files.junit import JunitCase, write_junit
from tests.conftest import ROOT

SCENARIOS = ROOT / "docs" / "scenarios"


def outcomes(report: Path) -> dict[str, tuple[str, str | None, str | None]]:
    """Return outcome, type and message of each case by its name; the counts are checked."""
    root = ElementTree.parse(report).getroot()
    [suite] = root
    found = {}
    for case in suite:
        assert case.get("classname") == suite.get("name")
        [told] = case
        name = case.get("name")
        assert name
        found[name] = told.tag, told.get("type"), told.get("message")
    tags = [tag for tag, *_ in found.values()]
    for element in (root, suite):
        assert element.get("tests") == str(len(tags))
        assert element.get("failures") == str(tags.count("failure"))
        assert element.get("skipped") == str(tags.count("skipped"))
        assert element.get("errors") == str(tags.count("error"))
    return found


def test_a_fault_fails_a_drive_without_verdict_is_skipped_a_healthy_one_passes(
    ninety_seconds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a drive, its beginning, which is too short, and the drive with a late sensor
    monkeypatch.chdir(tmp_path)
    short, late, report = Path("short.log"), Path("late.log"), Path("report.xml")
    short.write_text("\n".join(ninety_seconds.read_text().splitlines()[:5000]) + "\n")
    fault = ["--fault", "delay_rich_to_lean=0.6@20"]
    assert cli.main(["inject", str(ninety_seconds), "--out", str(late), *fault]) == 0
    call = ["replay", str(ninety_seconds), str(short), str(late), "--quiet", "--junit", str(report)]
    # WHEN they are replayed THEN each is one test
    assert cli.main(call) == 1
    found = outcomes(report)
    assert found[str(ninety_seconds)] == ("system-out", None, None)
    tag, kind, message = found["short.log"]
    assert (tag, kind) == ("skipped", None)
    assert message and message.startswith("not judged: ")
    sentence = "FAULT: P015A delay_rich_to_lean (pending, 43 s)"
    assert found["late.log"] == ("failure", "P015A", sentence)
    # and the next run replaces its own report with the same bytes, no other's file
    before = report.read_bytes()
    assert cli.main(call) == 1
    assert report.read_bytes() == before
    report.write_text("<testsuites name='of another program'/>")
    assert cli.main(call) == 2


def test_each_of_several_scenarios_is_one_test(
    ninety_seconds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a scenario that is met, and one whose code comes later than wanted
    silent, late, report = SCENARIOS / "silent_ecu.toml", tmp_path / "l.toml", tmp_path / "r.xml"
    late.write_text(
        '[[fault]]\nname = "delay_rich_to_lean"\nstart_s = 20\n'
        '[[expect]]\ncode = "P015A"\nwithin_s = 5\n'
    )
    call = ["inject", str(ninety_seconds), "--scenario", str(silent), str(late), "--assert"]
    # WHEN both are judged THEN one fails, and says why
    assert cli.main([*call, "--junit", str(report)]) == 1
    (passed, met), (failed, unmet) = outcomes(report).items()
    assert passed == f"{silent}: The message that carries lambda stops"
    assert met == ("system-out", None, None)
    assert (failed, *unmet[:2]) == (str(late), "failure", "P015A within 5 s")
    said = unmet[2]
    assert said and said.startswith("drive 1: P015A within 5 s, seen P015A pending (delay_rich")
    lines = capsys.readouterr().out.splitlines()
    assert lines.index(passed) < lines.index(failed)


def test_a_test_that_cannot_be_tried_is_an_error_beside_the_others(
    ninety_seconds: Path, tmp_path: Path
) -> None:
    # GIVEN a drive and a log that is gone, and a bus that nobody has
    gone, report = tmp_path / "gone.log", tmp_path / "r.xml"
    scenario, junit = str(SCENARIOS / "silent_ecu.toml"), ["--junit", str(report)]
    # WHEN they are to be judged THEN the file has the error under the name of what was tried
    logs = ["replay", str(gone), str(ninety_seconds), "--json", str(tmp_path / "found.json")]
    assert cli.main([*logs, *junit]) == 2
    passed, (name, told) = outcomes(report).items()
    assert passed[0] == str(ninety_seconds)
    missing = f"{gone}: cannot read it: No such file or directory"
    assert (name, told) == (str(gone), ("error", None, missing))
    [judged] = json.loads((tmp_path / "found.json").read_text())["recordings"]
    assert judged["path"] == str(ninety_seconds)
    # and with a fault memory none is judged whose earlier driving cycle is missing
    assert cli.main([*logs, *junit, "--memory", str(tmp_path / "memory")]) == 2
    assert [*outcomes(report)] == [str(gone)]
    bus = ["-i", "socketcan", "-c", "nosuch0", "--to-channel", "nosuch1"]
    assert cli.main(["inject", *bus, "--scenario", scenario, "--assert", *junit]) == 2
    [(name, (tag, _, message))] = outcomes(report).items()
    assert name.startswith(scenario)
    assert tag == "error"
    assert message and "cannot open the bus (socketcan nosuch0)" in message


def test_a_name_that_xml_cannot_hold_is_escaped(tmp_path: Path) -> None:
    report = tmp_path / "r.xml"
    odd = JunitCase('a\x1b"<\udcff>.log', "x\x00y", "no & <b>", "P1")
    write_junit(report, "o2mon.replay", [odd])
    [[case]] = ElementTree.parse(report).getroot()
    assert case.get("name") == 'a\\x1b"<\\udcff>.log'
    assert case[0].get("message") == "no & <b>"
    assert case[0].text == "x\\x00y"
