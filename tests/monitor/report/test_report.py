"""The report is one page that says what the result says, and loads nothing."""

import base64
import hashlib
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from monitor.judge.findings import DtcChanged
from monitor.memory.codes import CODES
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline.collector import Trace
from monitor.report import page as report
from monitor.report.lines import event_line, print_recording
from monitor.report.page import series, thinned, write_report
from monitor.report.words import confidence, known_faults

SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
HOSTILE = "</script><script>alert(1)</script>&\"'.log"


class Page(HTMLParser):
    """The elements of a page with their attributes, and the text of each script and style."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.raw: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag in ("script", "style"):
            self.raw.append("")

    def handle_data(self, data: str) -> None:
        if self.elements and self.cdata_elem is not None:
            self.raw[-1] += data
        else:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]

    def script(self, **wanted: str) -> list[str]:
        blocks = [(name, a) for name, a in self.elements if name in ("script", "style")]
        return [
            raw
            for (name, a), raw in zip(blocks, self.raw, strict=True)
            if name == "script" and all(a.get(key) == value for key, value in wanted.items())
        ]


def trace(n: int = 300) -> Trace:
    t_s = np.arange(n) * 0.1
    predicted = 1.0 + 0.01 * np.sin(t_s)
    measured = predicted + 0.002
    measured[10:13] = np.nan
    enabled = (np.arange(n) >= 50) & (np.arange(n) < n - 20)
    return Trace(t_s, measured, predicted, enabled, np.arange(n) >= 200)


def window(index: int, verdict: str, fault: str | None = None) -> dict[str, Any]:
    start_s = 5.0 + 5.0 * index
    return {
        "index": index,
        "t_start_s": start_s,
        "t_end_s": start_s + 4.9,
        "mean": 0.002,
        "std": 0.0041,
        "paper_failed": verdict == "failed",
        "verdict": verdict,
        "fault": fault,
        "statistics": {"evidence": -3.5, "hypothesis": "healthy", "gain": math.nan, "own_key": 7.0},
    }


def recording(path: str = "drives/healthy.log", **changes: Any) -> dict[str, Any]:
    made: dict[str, Any] = {
        "path": path,
        "sha256": SHA256,
        "samples": 300,
        "enabled_samples": 230,
        "windows": [window(0, "passed"), window(1, "inconclusive")],
        "dtcs": [],
        "fault_flag": False,
        "not_judged": None,
        "enable": {"inputs_valid": 0.99, "coolant_warm": 0.125, "engine_load": "unavailable"},
        "limits": {"j_mu": 0.01, "j_sigma": 0.02},
        "counters": {"checksum": 4, "late": 0},
    }
    return made | changes


def faulty(path: str = "drives/slow.log", **changes: Any) -> dict[str, Any]:
    dtc = {"code": "P014C", "fault": "slow_rich_to_lean", "status": 0x27, "state": "pending"}
    return recording(
        path,
        windows=[window(0, "passed"), window(1, "failed", "slow_rich_to_lean")],
        dtcs=[dtc | {"t_s": 20.0, "also": ["transient"]}],
        fault_flag=True,
        **changes,
    )


def not_judged(path: str = "drives/short.log") -> dict[str, Any]:
    cause = {
        "condition": "coolant_warm",
        "held_share": 0.125,
        "signal": "coolant_temperature_degc",
        "reason": "below",
        "advice": "record until the engine is warm",
    }
    return recording(path, windows=[], not_judged=[cause], enabled_samples=0)


def written(tmp_path: Path, *recordings: dict[str, Any], **options: Any) -> Page:
    path = tmp_path / "report.html"
    traces = options.pop("traces", [trace() for _ in recordings])
    result = {"schema": "o2mon.replay/1", "recordings": list(recordings)}
    chosen = {"model_info": {"kind": "narx"}} | options
    write_report(path, result, traces, **chosen)
    return Page(path.read_text("utf-8"))


def test_the_page_says_verdicts_codes_and_why_a_drive_was_not_judged(tmp_path: Path) -> None:
    text = written(tmp_path, recording(), faulty(), not_judged()).text
    # THEN all three verdicts stand there in words, with symbols beside the colours
    assert "3 recordings · fault found: 1 · no fault: 1 · not judged: 1" in text
    for verdict in ("✕ fault found", "✓ no fault", "? not judged"):
        assert text.count(verdict) == 2, verdict  # in the summary and above the recording
    # AND the code with its fault, state, time and status byte
    for shown in ("P014C", "slow_rich_to_lean or transient", "pending", "20.0 s", "0x27"):
        assert shown in text
    assert "The coolant is warm for 12 % of the time: record until the engine is warm" in text
    # AND what a window must have to fail by the paper's rule
    assert re.search(r"failed in \d+ windows?: \|mean\| ≥ J μ 0.01 lambda and", text)
    # AND what the enable conditions and frames were, the file's sha256 and the model
    for words in ("coolant is warm", "12.5 %", "unavailable", "a wrong checksum", SHA256, "narx"):
        assert words in text


def test_reason_and_confidence_stand_beside_the_verdict(tmp_path: Path) -> None:
    # GIVEN a fault with its evidence, a healthy drive, and one that was not judged
    decided = {"needed": 11.513, "seconds_to_decision": 0.0}
    odds = {"slow_rich_to_lean": {"log_odds": 30.0, **decided}}
    far = {"slow_rich_to_lean": {"log_odds": -12.5, **decided, "needed": 9.21}}
    shown = [faulty(evidence=odds), recording(evidence=far), not_judged()]
    text = written(tmp_path, *shown).text
    # THEN the summary says why, and the verdict how sure the test is
    assert "P014C slow_rich_to_lean or transient (pending, 20.0 s): slow on rich-to-lean" in text
    assert "for slow_rich_to_lean stands 2.6 times the evidence a decision needs" in text
    assert (
        "nearest to a fault is slow_rich_to_lean: against it stands 1.4 times the evidence" in text
    )
    assert "Every test was completed and passed." in text
    assert "Confidence: none, a test is missing." in text
    assert text.count("Confidence:") == 4  # of each recording, and of the worst on top
    # AND the worst of them leads the page
    lead = text[: text.index("3 recordings · ")]
    assert "Fault found in 1 of 3 recordings." in lead
    assert "for slow_rich_to_lean stands 2.6 times" in lead
    # AND what to do about the code stands below it
    assert "What to do about P014C" in text
    assert "Likely causes: an aged sensor; " in text


def test_evidence_against_a_stored_code_is_said_to_stand_against_it() -> None:
    # GIVEN a code of an earlier drive, and a drive that speaks against its fault
    odds = {"log_odds": -23.0, "needed": 11.5, "seconds_to_decision": 0.0}
    stored = faulty(evidence={"slow_rich_to_lean": odds})
    stored["dtcs"][0] |= {"probability": 0.3}
    stored["dtcs"].append(stored["dtcs"][0] | {"probability": 1.0})  # two codes of one fault
    # THEN the confidence says once which fault each number is of
    assert confidence(stored).split("; ") == [
        "against slow_rich_to_lean stands 2.0 times the evidence a decision needs",
        "30\xa0% for slow_rich_to_lean among the names of P014C",
    ]


def test_a_code_of_the_monitor_itself_hides_no_reason_and_is_no_fault(tmp_path: Path) -> None:
    lost = {"code": "P062F", "fault": "memory_lost", "status": 0x2F, "state": "confirmed"}
    text = written(tmp_path, not_judged() | {"dtcs": [lost | {"t_s": None}]}).text
    assert "Not judged. The coolant is warm for 12 % of the time: record until " in text
    assert "Confidence: none, a test is missing." in text
    assert "P062F" in text  # among the codes


def test_a_worn_catalyst_has_the_evidence_of_its_own_test() -> None:
    # GIVEN a code of the catalyst, whose response test of the upstream sensor says nothing
    worn = {"dtcs": [{"fault": "catalyst_low", "code": "P0420"}], "not_judged": None}
    bank = {"log_odds": 13.8, "sensor_log_odds": -11.5, "needed": 9.21}
    # THEN the verdict is as sure as the bank is, or as the front sensor's excursions are
    expected = "for catalyst_low stands 1.5 times the evidence a decision needs"
    assert confidence(worn | {"catalyst": bank}) == expected
    assert confidence(worn | {"catalyst": {"method": "activity"} | bank}) == expected
    # AND a circuit has limits, no evidence
    open_circuit = {"dtcs": [{"fault": "downstream_inactive", "code": "P0140"}], "catalyst": bank}
    assert confidence(open_circuit).startswith("not given")


def test_the_page_loads_nothing_and_allows_nothing_but_its_own_script(tmp_path: Path) -> None:
    page = written(tmp_path, recording(), faulty())
    # no element refers to anything outside the page, none carries script or style in an attribute
    for tag, attributes in page.elements:
        for name, value in attributes.items():
            if name in ("src", "href", "srcset", "action", "data", "poster"):
                assert (value or "").startswith("#"), (tag, name, value)
            assert not name.startswith("on"), (tag, name)
            assert name != "style", tag
    assert not page.of("link")
    style = page.raw[0]
    assert not re.search(r"url\(|@import", style)
    # the policy names the hashes of exactly the script and style that are there
    (policy,) = (a["content"] for a in page.of("meta") if a.get("http-equiv"))
    (script,) = (s for s in page.script() if "uPlot" in s)
    assert policy and policy.startswith("default-src 'none';")
    assert "unsafe" not in policy
    for content in (script, style):
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert "The MIT License" in script


def test_a_hostile_name_stays_text(tmp_path: Path) -> None:
    # GIVEN markup wherever a result holds text from outside
    bad = faulty(HOSTILE, source=HOSTILE, counters={HOSTILE: 1})
    bad["enable"] = {HOSTILE: 0.5}
    bad["windows"][0]["fault"] = HOSTILE
    bad["windows"][0]["statistics"] = {HOSTILE: HOSTILE}
    bad["dtcs"][0]["fault"] = HOSTILE
    page = written(tmp_path, bad, model_info={HOSTILE: HOSTILE}, output=HOSTILE)
    # THEN the page has its own scripts only, and shows the name as it is
    assert len(page.of("script")) == 2
    assert not any(script.strip() == "alert(1)" for script in page.script())
    assert HOSTILE in page.text.replace(" ", "")
    (data,) = page.script(type="application/json")
    assert json.loads(data)["windows"][0]["fault"] == HOSTILE


def test_the_embedded_series_are_those_of_the_trace(tmp_path: Path) -> None:
    given = trace()
    page = written(tmp_path, recording(), faulty(), traces=[given, trace(120)])
    first, second = (json.loads(block) for block in page.script(type="application/json"))
    assert first["t_s"] == {"start": 0.0, "period": 0.1, "count": 300}
    assert first["measured"][10:13] == [None, None, None]
    kept = np.array([math.nan if v is None else v for v in first["measured"]])
    np.testing.assert_allclose(kept, given.measured, rtol=6e-5)
    np.testing.assert_allclose(first["predicted"], given.predicted, rtol=6e-5)
    assert first["enabled"] == [[5.0, 28.0]]
    assert first["fault_flag"] == [[20.0, 30.0]]
    assert first["windows"][0]["statistics"]["gain"] is None
    assert second["dtcs"][0]["code"] == "P014C"
    assert second["t_s"]["count"] == 120


def test_simulated_recordings_are_called_so(tmp_path: Path) -> None:
    assert "imulated" not in written(tmp_path, recording(), faulty()).text
    mixed = written(tmp_path, recording(), faulty(source="simulated")).text
    assert "Simulated. 1 of 2 recordings" in mixed
    assert "Fault found (simulated)." in mixed
    assert "No fault (simulated)." not in mixed
    every = written(tmp_path, recording(source="simulated"), faulty(source="simulated")).text
    assert "Simulated. 2 recordings" in every
    assert "No fault (simulated)." in every


def test_a_recording_without_series_or_windows_is_reported(tmp_path: Path) -> None:
    empty = Trace.unpredicted(np.empty(0), np.empty(0))
    page = written(tmp_path, not_judged(), traces=[empty])
    assert json.loads(page.script(type="application/json")[0])["samples"] == 0
    assert "No window of enabled samples was filled." in page.text


def test_a_long_recording_is_thinned_without_losing_extremes_and_gaps() -> None:
    # GIVEN more samples than a page can hold, with one spike each way and a short gap
    n = 10 * report.MAX_SAMPLES + 7
    long = trace(n)
    long.measured[n // 2] = 3.0
    long.predicted[n // 3] = 0.2
    long.measured[n // 4 : n // 4 + 3] = np.nan
    keep = thinned(long)
    # THEN few samples are left, in order, and all of these are among them
    assert len(keep) <= report.MAX_SAMPLES
    assert np.all(np.diff(keep) > 0)
    assert {n // 2, n // 3} <= set(keep.tolist())
    assert np.isnan(long.measured[keep][100:]).any()
    made = series(recording(), long)
    assert made["shown"] == len(made["measured"]) == len(made["t_s"])
    assert made["samples"] == n


def test_a_drive_of_thirty_minutes_takes_less_than_a_megabyte(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    n = 18_000
    noise = rng.normal(0.0, 0.01, (2, n))
    drive = Trace(np.arange(n) * 0.1, 1 + noise[0], 1 + noise[1], noise[0] > -9, noise[0] > 9)
    windows = [window(i, "passed") for i in range(n // 50)]
    sizes = []
    for recordings in ([], [recording(windows=windows)]):
        written(tmp_path, *recordings, traces=[drive] * len(recordings))
        sizes.append((tmp_path / "report.html").stat().st_size)
    assert len(thinned(drive)) == n
    assert sizes[1] - sizes[0] < 1_000_000


def test_times_that_stand_on_no_grid_are_kept_one_by_one() -> None:
    t_s = np.array([0.0, 0.1, 0.5, 0.6])
    off = np.zeros(4, dtype=bool)
    made = series(recording(), Trace(t_s, t_s, t_s, ~off, off))
    assert (made["t_s"], made["fault_flag"]) == (t_s.tolist(), [])


def test_a_line_about_a_code_whose_test_passes_does_not_call_it_new() -> None:
    (failed,) = DtcStore().fail("gain_low", 7)
    at: Any = SimpleNamespace(seconds=lambda t_ns: t_ns / 1e9)
    lines = [event_line(DtcChanged(7, dtc), at) for dtc in (failed, failed.complete())]
    assert lines[1] == f"{lines[0]}, does not fail now"


def test_a_run_of_days_says_that_it_counts_the_latest_windows(tmp_path: Path) -> None:
    days = faulty(windows_dropped=98)
    assert "(the latest 2 of 100)" in "\n".join(print_recording(days))
    page = written(tmp_path, days).text
    assert "(the latest 2 of 100)" in page and "Latest 2 windows as a table" in page


def test_every_fault_has_a_meaning_causes_and_a_next_step() -> None:
    assert set(known_faults()) == set(CODES)
    assert all(len(each.causes) >= 2 for _, each in known_faults().values())
