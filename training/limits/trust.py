"""What a model finds and mistakes on drives that it has not seen, for its card.

Every drive is judged as it is and with each fault put on the reading afterwards, which the control
loop would answer in a car.
"""

from collections import Counter
from dataclasses import replace
from typing import Any, Final, NamedTuple

from monitor.base.config import Config
from monitor.base.faults import resolve
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard
from training.limits.judging import judge_recordings
from training.narx.model_file import Unseen
from training.recordings.sensor_fault import put_on

# the limit severities of the project's targets; of an offset twice that, because without a fault
# memory a drive does not know its vehicle's own offset
LIMIT_FAULTS: Final = (
    *((f"slow_{edge}", 0.5) for edge in ("rich_to_lean", "lean_to_rich", "symmetric")),
    *((f"delay_{edge}", 0.4) for edge in ("rich_to_lean", "lean_to_rich", "symmetric")),
    ("transient", 0.5),
    ("gain_low", 0.6),
    ("biased_lean", 0.1),
    ("biased_rich", 0.1),
)
LEAST_WINDOWS: Final = 10  # of a drive that counts, if any has as many
MOST_DRIVES: Final = 10
MOST_S: Final = 3600.0  # of a drive, its begin


class _Told(NamedTuple):
    """What a model says of a drive."""

    found: list[str]  # faults that were put on and set a code
    false: set[str]  # that set a code without
    explained: float


def trust_of(unseen: Unseen, card: ModelCard, config: Config, where: str) -> dict[str, Any]:
    """Return the trust of a card, whose limits judge; {} if no drive has a window.

    where : name of the model, for errors
    Where no drive has ten windows, shorter ones tell what there is to tell.
    """
    limits = Limits.from_card(replace(card, trust={}), config, where)
    faults = [resolve(name, severity) for name, severity in LIMIT_FAULTS]
    if card.transform != "phi":  # the unit of an offset is not known
        faults = [fault for fault in faults if not fault.offset_lambda]
    told = list[_Told](), list[_Told]()  # of short drives, of long ones
    for model, recordings in unseen:
        for recording in recordings:
            if len(told[True]) == MOST_DRIVES:
                break
            drive = recording.part(0, round(MOST_S * 1e9 / recording.period_ns))
            faulty = [put_on(drive, fault, card.output.name, card.transform) for fault in faults]
            healthy, *others = judge_recordings([drive, *faulty], model, limits, config)
            pairs = zip(faults, others, strict=True)
            found = [fault.name for fault, judged in pairs if judged.dtcs]
            own = _Told(found, {dtc.fault for dtc in healthy.dtcs}, healthy.explained or 0.0)
            if healthy.windows:
                told[len(healthy.windows) >= LEAST_WINDOWS].append(own)
    drives = told[True] or told[False]
    if not drives:
        return {}
    return {
        "drives": len(drives),
        "found": {fault.name: sum(fault.name in each.found for each in drives) for fault in faults},
        "false": dict(Counter(name for each in drives for name in sorted(each.false))),
        "explained": min(each.explained for each in drives),
        "severity": {fault.name: fault.severity for fault in faults},
    }
