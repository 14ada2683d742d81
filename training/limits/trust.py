"""What a model finds and mistakes on drives that it has not seen, for its card.

Every drive is judged as it is and with each fault put on the reading afterwards, which the control
loop would answer in a car.
"""

from collections import Counter, defaultdict
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
    *(("transient", 0.5), ("gain_low", 0.6), ("biased_lean", 0.1), ("biased_rich", 0.1)),
)
LEAST_WINDOWS: Final = 10  # of a drive that counts, if any has as many
MOST_DRIVES: Final = 10
MOST_S: Final = 3600.0  # of a drive, its begin


class _Told(NamedTuple):
    """What a model says of a drive, or of a part of one."""

    found: list[str]  # faults that were put on and set a code
    false: set[str]  # that set a code without
    explained: float


def trust_of(unseen: Unseen, card: ModelCard, config: Config, where: str) -> dict[str, Any]:
    """Return the trust of a card, whose limits judge; {} if no drive has a window.

    where : name of the model, for errors
    Where no drive has ten windows, shorter ones tell what there is to tell. A drive of several
    parts is one: it counts as found what half of them find, as false what any of them does.
    """
    limits = Limits.from_card(replace(card, trust={}), config, where)
    every, is_lambda = (resolve(*each) for each in LIMIT_FAULTS), card.transform == "phi"
    faults = [fault for fault in every if is_lambda or not fault.offset_lambda]  # unit not known
    told = defaultdict[str, list[_Told]](list), defaultdict[str, list[_Told]](list)  # short, long
    for model, recording in ((model, each) for model, recordings in unseen for each in recordings):
        if sum(map(len, told[True].values())) == MOST_DRIVES:
            break
        drive = recording.part(0, round(MOST_S * 1e9 / recording.period_ns))
        faulty = [put_on(drive, fault, card.output.name, card.transform) for fault in faults]
        healthy, *others = judge_recordings([drive, *faulty], model, limits, config)
        found = [f.name for f, judged in zip(faults, others, strict=True) if judged.dtcs]
        if healthy.windows:
            own = _Told(found, {dtc.fault for dtc in healthy.dtcs}, healthy.explained or 0.0)
            told[len(healthy.windows) >= LEAST_WINDOWS][recording.sha256].append(own)
    if not (drives := [*(told[True] or told[False]).values()]):
        return {}

    def finds(drive: list[_Told], name: str) -> bool:
        return 2 * sum(name in part.found for part in drive) >= len(drive)

    mistaken = (set[str]().union(*(part.false for part in drive)) for drive in drives)
    return {
        "drives": len(drives),
        "found": {f.name: sum(finds(drive, f.name) for drive in drives) for f in faults},
        "false": dict(Counter(name for names in mistaken for name in sorted(names))),
        "explained": min(part.explained for drive in drives for part in drive),
        "severity": {fault.name: fault.severity for fault in faults},
    }
