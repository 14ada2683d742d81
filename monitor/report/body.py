"""The text of the report as HTML: summary, verdicts, codes, windows, enable conditions, model.

Every value from outside passes through ``elements.text``. ``static/report.js`` draws the plots.
"""

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from monitor.base.counts import counted, duration
from monitor.judge import trust
from monitor.judge.causes.causes import Cause
from monitor.judge.enable import statement
from monitor.pipeline.entry import fault_words
from monitor.report import catalyst, evidence
from monitor.report.elements import number, path, table, term_list, text
from monitor.report.words import (
    CATALYST_ALONE,
    VERDICTS,
    advice,
    confidence,
    counted_out,
    has_model,
    is_catalyst_alone,
    is_simulated,
    meaning,
    not_listed,
    passed_beside,
    tests,
    verdict_counts,
    verdict_of,
)

OPEN_AT_FIRST = 4  # up to this number, all recordings are shown unfolded


def body(
    recordings: Sequence[Mapping[str, Any]],
    model_info: Mapping[str, str],
    output: str,
    steps: Mapping[str, str],
) -> str:
    """Return the page's body without data and script."""
    simulated = [r for r in recordings if is_simulated(r)]
    note = ""
    if simulated:
        total = counted(len(recordings), "recording")
        which = total if len(simulated) == len(recordings) else f"{len(simulated)} of {total}"
        note = (
            f'<p class="note"><strong>Simulated.</strong> {which} on this page: from a simulation, '
            "not from a vehicle. The results are marked.</p>"
        )
    lead = overview = ""
    if len(recordings) > 1:
        lead, overview = _lead(recordings), _summary(recordings)
    opened = len(recordings) <= OPEN_AT_FIRST
    sections = "\n".join(
        _recording(i, recording, output, opened) for i, recording in enumerate(recordings)
    )
    return (
        f"<header><h1>Oxygen sensor monitor</h1>{lead}{note}</header>\n<main>\n"
        f"{overview}\n{sections}\n{_model(model_info, recordings)}\n{_steps(steps)}\n</main>"
    )


def _lead(recordings: Sequence[Mapping[str, Any]]) -> str:
    """Return the verdict on the worst of several recordings, its reason and its confidence."""
    verdicts = [verdict_of(recording) for recording in recordings]
    worst = next(verdict for verdict in ("failed", "inconclusive", "passed") if verdict in verdicts)
    own = recordings[verdicts.index(worst)]
    words = VERDICTS[worst][1].capitalize()
    words += f" in {verdicts.count(worst)} of {len(recordings)} recordings"
    reason = _sentence(own)
    if worst != "passed":
        reason = f"{path(PurePath(str(own['path'])).name)}: {reason}"
    return (
        f'<div class="verdict {worst}" role="status"><p><strong>{words}.</strong> {reason}</p>'
        f"{_confidence(own)}</div>"
    )


def _summary(recordings: Sequence[Mapping[str, Any]]) -> str:
    names = [PurePath(str(r["path"])).name for r in recordings]
    alike = len(set(names)) < len(names)
    rows = [
        {
            "Recording": f'<a href="#recording-{i}">{path(name)}</a>{_tag(recording)}',
            "Verdict": _badge(recording),
            "Reason": _sentence(recording),
            "Windows": _counts(recording),
            "Enabled": _enabled(recording),
        }
        for i, recording in enumerate(recordings)
        for name in (recording["path"] if alike else names[i],)
    ]
    verdicts = [verdict_of(recording) for recording in recordings]
    words = " · ".join(
        f"{label}: {verdicts.count(verdict)}"
        for verdict, (_, label) in VERDICTS.items()
        if verdict in verdicts
    )
    return (
        f'<section><h2>Summary</h2><p class="quiet">{counted(len(recordings), "recording")} · '
        f"{words}</p>{table(rows, 'summary cards')}</section>"
    )


def _recording(i: int, recording: Mapping[str, Any], output: str, opened: bool) -> str:
    n = verdict_counts(recording)
    facts = [
        ("Samples", f"{recording['samples']:,}".replace(",", " ")),
        ("Enabled", _enabled(recording)),
        ("Windows", _counts(recording)),
        *([("Tests", text(told))] if (told := tests(recording)) else []),
        *_paper(recording.get("limits"), n["paper"], text(output)),
        *_limits(recording.get("limits", {}), text(output)),
        *_memory(recording.get("memory")),
        *_logger(recording),
        ("File", f'<span class="wide">{path(recording["path"])}</span>'),
        ("sha256", f'<code class="wide hash">{text(recording["sha256"])}</code>'),
    ]
    verdict = verdict_of(recording)
    name = PurePath(str(recording["path"])).name
    simulated = " (simulated)" if is_simulated(recording) else ""
    shown = "Measured and predicted" if has_model(recording) else "Measured"
    return (
        f'<details class="recording" id="recording-{i}"{" open" if opened else ""}>'
        f"<summary><h2>{path(name)}</h2>{_tag(recording)}{_badge(recording)}</summary>"
        f'<div class="verdict {verdict}"><p><strong>{VERDICTS[verdict][1].capitalize()}'
        f"{simulated}.</strong> {_sentence(recording)}</p>{_confidence(recording)}"
        f"{term_list(facts)}</div>"
        f"{_causes(recording)}{_dtcs(recording)}{_evidence(recording)}{_behind(recording)}"
        f'<section class="plots" data-series="series-{i}" data-name="{text(name)}{simulated}" '
        f'aria-label="{shown} {text(output)} over time"></section>'
        f'<noscript><p class="quiet">The plots need JavaScript.</p></noscript>'
        f"{_windows(recording)}"
        f'<div class="columns">{_enable(recording)}{_counters(recording)}</div></details>'
    )


def _logger(recording: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the profile of a logger's file, and its oddities."""
    facts = []
    if "profile" in recording:
        facts.append(("Profile", f"<code>{text(recording['profile'])}</code>"))
    if "notes" in recording:
        notes = "; ".join(map(text, recording["notes"]))
        facts.append(("Log", f'<span class="wide">{notes}</span>'))
    return facts


def _sentence(recording: Mapping[str, Any]) -> str:
    if recording["fault_flag"]:
        return "; ".join(
            f"{text(d['code'])} {text(fault_words(d))} ({_state(d)}): {_meaning(d)}"
            for d in recording["dtcs"]
        )
    causes = recording["not_judged"]
    if causes:
        said, signal = passed_beside(recording) + Cause(**causes[0]).in_words, causes[0]["signal"]
        return text(said if said.startswith(signal or " ") else said[0].upper() + said[1:])
    return _passed(recording)


def _passed(recording: Mapping[str, Any]) -> str:
    """Return that every test passed, and if so, of those that this model can do."""
    if is_catalyst_alone(recording):
        return f"{CATALYST_ALONE[0].upper()}{CATALYST_ALONE[1:]}."
    left = recording.get("trust", {}).get("not_tested")
    return f"Every test {'that this model can do' if left else 'was completed and'} passed."


def _confidence(recording: Mapping[str, Any]) -> str:
    known = trust.in_words(recording.get("trust"))
    more = f"<p>{text(known[0].upper() + known[1:])}.</p>" if known else ""
    return f"<p>Confidence: {text(confidence(recording))}.</p>{more}"


def _causes(recording: Mapping[str, Any]) -> str:
    """Return the causes why a recording was not judged as a table."""
    rows = [
        {
            "Condition": text(statement(cause["condition"])),
            "Held": _share(cause["held_share"]),
            "Signal": f"<code>{text(cause['signal'])}</code>" if cause["signal"] else "",
            "Reason": text(cause["reason"].replace("_", " ")),
            "Advice": f'<span class="wide">{text(cause["advice"])}</span>',
        }
        for cause in recording["not_judged"] or ()
    ]
    return f"<h3>Why not judged</h3>{table(rows, 'cards')}" if rows else ""


def _share(share: float | None) -> str:
    return "–" if share is None else f"{100.0 * share:.0f}\u00a0%"


def _dtcs(recording: Mapping[str, Any]) -> str:
    if not recording["dtcs"]:
        return '<h3>Trouble codes</h3><p class="quiet">None is pending or confirmed.</p>'
    rows = [
        {
            "Code": f'<strong class="code">{text(dtc["code"])}</strong>',
            "Fault": f"<code>{text(fault_words(dtc))}</code>",
            "Meaning": _meaning(dtc),
            "State": text(dtc["state"]),
            "Set at": _set_at(dtc),
            "Status byte": f"<code>0x{int(dtc['status']):02X}</code>" if "status" in dtc else "",
        }
        for dtc in recording["dtcs"]
    ]
    told = "".join(
        f"<h3>What to do about {codes}</h3><p>{text(each.effect)}</p>"
        f"<p>Likely causes: {text('; '.join(each.causes))}.</p><p>Next: {text(each.check)}.</p>"
        for codes, each in advice(recording["dtcs"])
    )
    return f"<h3>Trouble codes</h3>{table(rows, 'cards')}{told}"


def _set_at(dtc: Mapping[str, Any]) -> str:
    """Return when a code was set, with a button that shows the plots there."""
    if dtc.get("t_s") is None:
        return "earlier driving cycle"
    show = f'<button type="button" data-show="{float(dtc["t_s"])!r}">show</button>'
    return f"{dtc['t_s']:.1f} s{show}"


def _evidence(recording: Mapping[str, Any]) -> str:
    """Return the evidence about each fault of the response test, folded up."""
    rows = [
        {"Fault": f"<code>{text(fault)}</code>", "Evidence": text(amount), "Decision": text(left)}
        for fault, amount, left in evidence.rows(recording)
    ]
    if not any(each["log_odds"] for each in recording.get("evidence", {}).values()):
        return ""
    title = "Evidence about each fault of the response test"
    is_open = " open" if recording["not_judged"] else ""
    return f"<details{is_open}><summary>{title}</summary>{table(rows, 'cards')}</details>"


def _behind(recording: Mapping[str, Any]) -> str:
    """Return what is known of catalyst and downstream sensor, "" without a downstream voltage."""
    own: Mapping[str, Any] | None = recording.get("catalyst")
    facts = [(name.capitalize(), text(words)) for name, words in catalyst.rows(own)]
    return f"<h3>Behind the catalyst</h3>{term_list(facts)}" if facts else ""


def _windows(recording: Mapping[str, Any]) -> str:
    """Return the place of the table of windows, which the script makes of the page's data."""
    windows = recording["windows"]
    if not windows:
        return '<p class="quiet">No window of enabled samples was filled.</p>'
    shown = "Latest" if not_listed(recording) else "All"
    summary = f"<summary>{shown} {counted(len(windows), 'window')} as a table</summary>"
    return f'<details class="windows">{summary}</details>'


def _enable(recording: Mapping[str, Any]) -> str:
    rows = []
    for name, share in recording.get("enable", {}).items():
        bar, held = "", text(share)
        if not isinstance(share, str):
            held = f"{100.0 * share:.1f} %"
            bar = (
                '<svg class="bar" viewBox="0 0 1 8" preserveAspectRatio="none" aria-hidden="true">'
                f'<rect class="all" width="1" height="8"/><rect width="{share:.3f}" height="8"/>'
                "</svg>"
            )
        rows.append({"condition": text(statement(name)), "bar": bar, "held": held})
    if not rows:
        return ""
    return (
        "<section><h3>Enable conditions</h3>"
        '<p class="quiet">Share of samples in which each held. A sample is judged when all hold; '
        "one that is unavailable does not block.</p>"
        f"{table(rows, 'conditions', head=False)}</section>"
    )


def _counters(recording: Mapping[str, Any]) -> str:
    rows = [{"what": text(words), "n": text(n)} for words, n in counted_out(recording)]
    shown = table(rows, "counters", head=False)
    return f"<section><h3>Left out, late or missing</h3>{shown}</section>" if rows else ""


def _model(model_info: Mapping[str, str], recordings: Sequence[Mapping[str, Any]]) -> str:
    """Return the facts of the model, "" if it judged none of the recordings."""
    if not model_info or not any(has_model(recording) for recording in recordings):
        return ""
    facts = [(text(key), text(value)) for key, value in model_info.items()]
    return f'<section class="model"><h2>Model</h2>{term_list(facts)}</section>'


def _steps(steps: Mapping[str, str]) -> str:
    """Return the commands that led to the result, with their output, "" if there were none."""
    parts = "".join(_step(text(command), text(said)) for command, said in steps.items())
    return f"<section><h2>Steps</h2>{parts}</section>" if steps else ""


def _step(command: str, said: str) -> str:
    page = "tables/report.html"  # of the tables for the ECU, whose step prints them
    is_made = f"{page}: " in said
    link = f'<p>Tables for the ECU: <a href="{page}">{page}</a></p>' if is_made else ""
    fold = f"<details{' open' * is_made}><summary><code>{command}</code></summary>"
    return f"{link}{fold}<pre>{said}</pre></details>"


def _badge(recording: Mapping[str, Any]) -> str:
    verdict = verdict_of(recording)
    symbol, words = VERDICTS[verdict]
    return f'<span class="badge {verdict}"><span aria-hidden="true">{symbol}</span> {words}</span>'


def _tag(recording: Mapping[str, Any]) -> str:
    source = recording.get("source")
    return f' <span class="tag">{text(source)}</span>' if source else ""


def _counts(recording: Mapping[str, Any]) -> str:
    n = verdict_counts(recording)
    words = ", ".join(
        f'<span class="mark {verdict if n[verdict] else ""}">{n[verdict]} {verdict}</span>'
        for verdict in ("passed", "failed", "inconclusive")
    )
    return words + not_listed(recording)


def _enabled(recording: Mapping[str, Any]) -> str:
    samples, enabled = recording["samples"], recording["enabled_samples"]
    share = f"{100.0 * enabled / samples:.0f}\u00a0%" if samples else "–"
    period_s = recording.get("period_s")
    return f"{duration(enabled * float(period_s))} ({share})" if period_s else share


def _state(dtc: Mapping[str, Any]) -> str:
    when = "" if dtc.get("t_s") is None else f", {dtc['t_s']:.1f} s"
    return text(dtc["state"]) + when


def _meaning(dtc: Mapping[str, Any]) -> str:
    return text(meaning(dtc["fault"], dtc.get("also", ())))


def _memory(found: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Return the fact about the fault memory on disk, if there was one and it was damaged."""
    if not found or found["state"] == "ok":
        return []
    aside = f", put aside as {path(found['set_aside'])}" if found["set_aside"] else ""
    return [("Fault memory", f"was damaged and is {text(found['state'])}{aside}")]


def _paper(limits: Mapping[str, Any] | None, failed: int, unit: str) -> list[tuple[str, str]]:
    """Return how many windows fail by the paper's rule, and what residuals such a window has."""
    if not limits:
        return []
    mean, std = (f"{number(limits[k])} {unit}" for k in ("j_mu", "j_sigma"))
    needs = f"|mean| ≥ J<sub>μ</sub> {mean} and standard deviation ≥ J<sub>σ</sub> {std}"
    words = f"failed in {counted(failed, 'window')}: {needs}"
    return [("Paper’s rule", f'<span class="wide">{words}</span>')]


def _limits(limits: Mapping[str, Any], unit: str) -> list[tuple[str, str]]:
    """Return the fact about the limits of the vehicle, ``unit`` being that of the residual."""
    words = []
    if "gain" in limits:
        words.append(f"gain of this vehicle {number(limits['gain'])}")
    if "offset_low" in limits:
        low, high = number(limits["offset_low"]), number(limits["offset_high"])
        words.append(f"offset {low} to {high} {unit}")
    return [("Limits", f'<span class="wide">{", ".join(words)}</span>')] if words else []
