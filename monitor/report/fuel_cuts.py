"""The test of the fuel-cut response in words: verdict, and each quantity with its limits."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from monitor.base.counts import counted
from monitor.judge.fuel_cut.cuts import LEVEL
from monitor.report.elements import plain

WORDS: Final = {
    "delay_rich_to_lean_s": "delay to lean, s",
    "rise_rich_to_lean_s": "rise to lean, s",
    "delay_lean_to_rich_s": "delay to rich, s",
    "rise_lean_to_rich_s": "rise to rich, s",
    LEVEL: "level in air",
}
VERDICTS: Final = {"passed": "passed", "failed": "failed", "inconclusive": "not decided"}
UNKNOWN: Final = "not judged (the model knows no healthy fuel cuts)"


def verdict(test: Mapping[str, Any]) -> str:
    """Return the verdict in words, with the faults, or with what is not decided."""
    names = ", ".join(test["faults"])
    if test["verdict"] == "inconclusive":
        findings = test["findings"]
        if findings and not any(map(_has_limits, findings.values())):
            return UNKNOWN
        names = ", ".join(
            WORDS[name].split(",")[0] for name, each in findings.items() if _is_open(each)
        )
    return VERDICTS[test["verdict"]] + (f" ({names})" if names else "")


def _has_limits(finding: Mapping[str, Any]) -> bool:
    return finding["low"] is not None and finding["high"] is not None


def _is_open(finding: Mapping[str, Any]) -> bool:
    """Return whether a quantity can be judged and has not passed."""
    return _has_limits(finding) and finding["verdict"] != "passed"


def rows(recording: Mapping[str, Any]) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield quantity, measured, predicted, limits and verdict of a recording's fuel cuts."""
    test = recording.get("fuel_cut_response") or {"findings": {}}
    for name, each in test["findings"].items():
        known = _has_limits(each)
        limits = f"{plain(each['low'])} to {plain(each['high'])}" if known else "none"
        sure = "" if each.get("std") is None else f" ± {plain(each['std'])}"
        values = plain(each["measured"]) + sure, plain(each["predicted"])
        yield WORDS[name], *values, limits, VERDICTS[each["verdict"]] if known else "not judged"


def lines(recording: Mapping[str, Any], *, in_detail: bool) -> Iterator[str]:
    """Yield the lines that a command prints about a recording's fuel cuts.

    in_detail : each quantity, also if the test has not failed; otherwise what is not decided
    """
    test = recording.get("fuel_cut_response")
    if test is None:
        return
    yield f"fuel-cut response: {verdict(test)}, {counted(test['cuts'], 'fuel cut')}"
    every = in_detail or test["verdict"] == "failed"
    findings = test["findings"].values()
    for finding, row in zip(findings, rows(recording), strict=True):
        if every or _is_open(finding):
            words, measured, predicted, limits, own = row
            yield f"  {words}: {measured}, predicted {predicted}, limits {limits}; {own}"
    if every and "span" in test:
        gain, std = (100.0 * test["span"][key] for key in ("gain", "std"))
        most = "at most " if test["clipped"] else ""
        yield f"  span of the sensor: {most}{max(gain, 0.0):.0f} % of healthy ones, ± {std:.0f} %"
