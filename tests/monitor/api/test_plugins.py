"""The example plug-ins, installed as a user installs them, and what they do in the monitor."""

import re
import subprocess
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import can
import numpy as np
import pytest

from monitor import Monitor, cli
from monitor.base.errors import ConfigError
from monitor.judge.decision import plugins as rules
from monitor.judge.window import Opinion
from monitor.memory import codes
from tests.conftest import ROOT
from tests.helpers.logs.replays import replays

PLUGINS = ROOT / "examples/plugins"
DRIVE = ROOT / "replay_logs/healthy_micro_trips_v102_s102.blf"
LATE = next((ROOT / "replay_logs").glob("delay_rich_to_lean_*.blf"))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    (source := folder / "source").mkdir()
    for path in filter(Path.is_file, PLUGINS.iterdir()):
        (source / path.name).write_bytes(path.read_bytes())
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", folder, source], check=True, capture_output=True)
    return folder


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(site)
    tables = codes.CODES, codes.TESTS, codes.TEST_OF
    before = [dict(table) for table in tables]
    rules.loaded.cache_clear()
    yield
    rules.loaded.cache_clear()
    for table, content in zip(tables, before, strict=True):
        table.clear()
        table.update(content)


@pytest.mark.parametrize("path", sorted(PLUGINS.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_has_thirty_lines_at_most(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 30


@pytest.mark.usefixtures("installed")
def test_a_sink_takes_the_records_of_its_scheme(tmp_path: Path) -> None:
    out = tmp_path / "codes.txt"
    call = ["replay", str(LATE), "--quiet", "--sink", f"codes:{out}", "--sink-tag", "vehicle=car17"]
    assert cli.main(call) == 1
    [line] = out.read_text().splitlines()
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d car17 P015A pending", line)


def noisy_table(folder: Path, noise: float) -> Path:
    from training.recordings.recording import load, write_table

    drive = load(DRIVE)
    values = drive.values.copy()
    column = drive.names.index("lambda_measured")
    values[:, column] += np.random.default_rng(1).normal(0.0, noise, len(values))
    path = folder / f"noise_{noise}.csv"
    write_table(path, drive.t_s, drive.names, values)
    return path


@pytest.mark.usefixtures("installed")
def test_a_rule_sets_its_code_once_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings, memory = tmp_path / "on.toml", tmp_path / "o2.db"
    settings.write_text('[rules]\nactive = ["noisy"]\n')
    logs = [str(noisy_table(tmp_path, noise)) for noise in (0.0, 0.05)]

    def judged(*options: str) -> list[list[str]]:
        _, found = replays(*logs, "--quiet", *options)
        return [[dtc["code"] for dtc in recording["dtcs"]] for recording in found]

    assert all("P1130" not in found for found in judged())
    own = judged("--config", str(settings), "--memory", str(memory))
    assert ["P1130" in found for found in own] == [False, True]
    # AND the memory keeps the code also where the rule is not installed
    rules.loaded.cache_clear()
    for table in (codes.CODES, codes.TESTS, codes.TEST_OF):
        table.pop("noisy", None)
    assert cli.main(["dtc", "list", "--memory", str(memory)]) == 0
    assert "P1130" in capsys.readouterr().out


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    "said",
    [
        None,
        Opinion("failed", "unknown"),
        Opinion("failed", "noisy", ("unknown",)),
        Opinion("failed", ["noisy"]),  # type: ignore[arg-type]
        Opinion("fine"),  # type: ignore[arg-type]
    ],
)
def test_a_rule_that_fails_is_switched_off_and_told_and_the_drive_keeps_its_verdict(
    said: Opinion | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a rule that raises an error, names a fault that it has not, or decides nothing known
    kind = rules.loaded("noisy")
    asked = []

    def judge(_self: object, window: object) -> Opinion:
        asked.append(window)
        if said is None:
            raise ZeroDivisionError
        return said

    monkeypatch.setattr(kind, "judge", judge)
    settings = tmp_path / "on.toml"
    settings.write_text('[rules]\nactive = ["noisy"]\n')
    # WHEN a drive is judged THEN the rule is asked once, and all else goes on
    code, (recording,) = replays(LATE, "--config", settings)
    assert (code, [dtc["code"] for dtc in recording["dtcs"]]) == (1, ["P015A"])
    assert len(asked) == 1
    (note,) = recording["notes"]
    assert re.fullmatch("the rule noisy fails: .*it is switched off", note)


@pytest.mark.usefixtures("installed")
def test_a_rule_that_cannot_be_made_is_switched_off_in_that_driving_cycle(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    kind = rules.loaded("noisy")
    monkeypatch.setattr(kind, "__init__", lambda self: 1 / 0)
    settings = tmp_path / "on.toml"
    settings.write_text('[rules]\nactive = ["noisy"]\n')
    code, (recording,) = replays(LATE, "--config", settings)
    assert (code, [dtc["code"] for dtc in recording["dtcs"]]) == (1, ["P015A"])
    assert recording["notes"] == ["the rule noisy fails: division by zero; it is switched off"]
    with Monitor(config=settings) as live, can.LogReader(LATE) as messages:  # as in a run
        for message in islice(messages, 10_000):
            live.push(message)
        assert live.verdict.entry["notes"] == recording["notes"]


OWN_RULES = """
class Clashing:
    faults = {"biased_lean": "P1131"}


class Public:
    faults = {"own": "P0133"}
"""


@pytest.mark.parametrize(
    ("name", "kind", "said"),
    [
        ("absent", None, "no such rule; installed are "),
        ("clashing", "Clashing", "the name biased_lean is taken"),
        ("public", "Public", "a new code from P1000 to P1FFF is wanted"),
        ("broken", "Missing", "fails: "),
    ],
)
def test_a_rule_that_cannot_be_used_is_named(
    name: str, kind: str | None, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind:
        (tmp_path / "own_rules.py").write_text(OWN_RULES)
        info = tmp_path / "own_rules-1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-rules\nVersion: 1\n")
        (info / "entry_points.txt").write_text(f"[{rules.GROUP}]\n{name} = own_rules:{kind}\n")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "own_rules", raising=False)
    with pytest.raises(ConfigError, match=rf"\[rules\] {name}: .*{said}"):
        rules.loaded(name)
