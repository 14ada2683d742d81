"""The entry of one recording in ``o2mon.replay/1``, streamed or judged as a whole."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import Quality, SampleBlock
from monitor.decode.block_decoder import MessageCounters
from monitor.decode.bus_map import BusMap
from monitor.grid.block_assembler import AssemblerCounters
from monitor.grid.tables import Table
from monitor.judge.causes.causes import Cause, SignalSource
from monitor.judge.decision.window_facts import Evidence
from monitor.judge.enable import CONDITIONS
from monitor.judge.findings import WindowJudged
from monitor.judge.limits import Limits
from monitor.memory.dtc import Dtc
from monitor.model.card import ModelCard


def seconds(t_ns: int, t0_ns: int) -> float:
    """Return a time in seconds since the recording's first sample at ``t0_ns``."""
    return (t_ns - t0_ns) / 1e9


def window_entry(event: WindowJudged, t0_ns: int) -> dict[str, Any]:
    """Return a judged window with its times in s."""
    times = seconds(event.window.t_start_ns, t0_ns), seconds(event.window.t_end_ns, t0_ns)
    entry = {"index": event.window.index, "t_start_s": times[0], "t_end_s": times[1]}
    return entry | window_fields(event)


def window_fields(event: WindowJudged) -> dict[str, Any]:
    """Return a judged window without its times."""
    return {
        "index": event.window.index,
        "mean": event.mean,
        "std": event.std,
        "paper_failed": event.paper_failed,
        "verdict": event.outcome,
        "fault": event.fault,
        "also": list(event.also),
        "excited": event.excited,
        "statistics": event.statistics,
    }


def evidence_entry(evidence: Mapping[str, Evidence]) -> dict[str, dict[str, float | None]]:
    """Return how far the response test is from a decision about each fault."""
    return {
        fault: {
            "log_odds": round(each.log_odds, 3),
            "needed": round(each.needed, 3),
            "seconds_to_decision": each.seconds_to_decision and round(each.seconds_to_decision, 1),
        }
        for fault, each in evidence.items()
    }


def dtc_entry(dtc: Dtc, t0_ns: int, probability: float) -> dict[str, Any]:
    """Return a code.

    probability : of its fault's name among the names with the same code
    """
    entry: dict[str, Any] = {
        "code": dtc.code,
        "fault": dtc.fault,
        "status": int(dtc.status),
        "state": dtc.state,
        "t_s": seconds(dtc.t_ns, t0_ns) if dtc.has_failed else None,
        "probability": round(probability, 4),
    }
    if dtc.also:
        entry["also"] = list(dtc.also)
    return entry


def fault_words(dtc: Mapping[str, Any]) -> str:
    """Return a code's fault as it is read: one name, or both with the probability of the first.

    dtc : as ``dtc_entry`` gives it
    Of two names the likelier stands first. No name is surer than 99 %: the bank of hypothetical
    sensors does not hold every sensor there is.
    """
    names, probability = [str(dtc["fault"]), *dtc.get("also", ())], dtc.get("probability")
    if len(names) == 1 or probability is None:
        return " or ".join(names)
    if len(names) == 2 and probability < 0.5:
        names, probability = names[::-1], 1.0 - probability
    return f"{names[0]} ({100.0 * min(probability, 0.99):.0f} %) or {' or '.join(names[1:])}"


def enable_shares(
    held: Sequence[int], n_samples: int, unavailable: Sequence[str]
) -> dict[str, float | str]:
    """Return for each condition in how much of the time it held.

    held : in how many of the samples, in the order of ``enable.CONDITIONS``
    """
    return {
        name: "unavailable" if name in unavailable else round(n / max(n_samples, 1), 6)
        for name, n in zip(CONDITIONS, held, strict=True)
    }


def limits_entry(limits: Limits) -> dict[str, float]:
    """Return the limits that a recording was judged with."""
    return {
        "j_mu": limits.j_mu,
        "j_sigma": limits.j_sigma,
        "offset_low": limits.offset_low,
        "offset_high": limits.offset_high,
        "gain": limits.gain,
    }


def not_judged(causes: Sequence[Cause]) -> list[dict[str, Any]] | None:
    """Return the causes that kept a recording from its verdict, None if it was judged."""
    return [asdict(cause) for cause in causes] or None


def bus_sources(bus_map: BusMap, names: Iterable[str]) -> dict[str, SignalSource]:
    """Return where the named signals come from on the bus."""
    found = {}
    for name in names:
        channels = [bus_map.channels[each] for each in bus_map.sources((name,))]
        places = [f"{each.message.name}.{each.signal.name}" for each in channels]
        timeout_s = min(each.mapped.timeout_s for each in channels)
        found[name] = SignalSource(" and ".join(places), timeout_s)
    return found


def frame_counts(
    messages: Mapping[str, MessageCounters], assembler: AssemblerCounters, unmapped: int
) -> dict[str, int]:
    """Return the number of frames that could not be used, by reason."""
    total = Counter[str]()
    for counters in messages.values():
        total.update(asdict(counters))
    lost = {name: n for name, n in total.items() if name not in ("received", "other")}
    lost |= asdict(assembler) | {"unmapped": unmapped}
    return lost | {f"never_received_{m}": 1 for m, c in messages.items() if c.received == 0}


def check_received(path: Path, messages: Mapping[str, MessageCounters], n_frames: int) -> None:
    """Raise RecordingError if a log holds none of the messages that are needed."""
    if not any(counters.received for counters in messages.values()):
        raise RecordingError(
            f"{path}: none of its {n_frames} frames is one of {', '.join(messages)}; "
            "wrong --dbc or --map?"
        )


def check_long_enough(path: Path, n_samples: int) -> None:
    """Raise RecordingError if a recording has no sample."""
    if n_samples == 0:
        raise RecordingError(f"{path}: shorter than one sample of the model's grid")


def table_counts(table: Table, block: SampleBlock, card: ModelCard) -> dict[str, int]:
    """Return how many values of each needed column are implausible.

    block : samples of all the table's columns, in their order
    Raises RecordingError if a column that the model needs holds no number.
    """
    needed = [table.names.index(name) for name in (*card.input_names, card.output.name)]
    empty = [table.names[i] for i in needed if not np.isfinite(table.values[:, i]).any()]
    if empty:
        raise RecordingError(f"{table.path}: no number in column {', '.join(empty)}")
    implausible = (block.quality == Quality.OUT_OF_RANGE).sum(axis=0).tolist()
    return {f"out_of_range_{table.names[i]}": implausible[i] for i in needed}
