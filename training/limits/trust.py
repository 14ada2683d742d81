"""What a model finds and mistakes on drives that it has not seen, for its card.

Every drive is judged as it is and with each fault put on the reading afterwards, which the control
loop would answer in a car.
"""

from collections import Counter
from dataclasses import replace
from typing import Any, Final

import numpy as np

from monitor.base.config import Config
from monitor.base.faults import Fault, resolve
from monitor.base.signals import OUTPUT
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard
from training.limits.judging import judge_recordings
from training.narx.model_file import Unseen
from training.recordings.recording import Recording
from training.recordings.sensor_fault import faulty_readings

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
LEAST_WINDOWS: Final = 10  # of a drive that counts
MOST_DRIVES: Final = 10
MOST_S: Final = 3600.0  # of a drive


def trust_of(unseen: Unseen, card: ModelCard, config: Config, where: str) -> dict[str, Any]:
    """Return the trust of a card, whose limits judge; without drives of 10 windows it found none.

    where : name of the model, for errors
    """
    limits = Limits.from_card(replace(card, trust={}), config, where)
    faults = [resolve(name, severity) for name, severity in LIMIT_FAULTS]
    if card.transform != "phi":  # the unit of an offset is not known
        faults = [fault for fault in faults if not fault.offset_lambda]
    found, false, drives = Counter({fault.name: 0 for fault in faults}), Counter[str](), 0
    explained = list[float]()
    for model, recordings in unseen:
        for drive in map(_begin, recordings):
            if drives == MOST_DRIVES:
                break
            faulty = [put_on(drive, fault, card.output.name, card.transform) for fault in faults]
            healthy, *others = judge_recordings([drive, *faulty], model, limits, config)
            if len(healthy.windows) < LEAST_WINDOWS:
                continue
            drives += 1
            explained.append(healthy.explained or 0.0)
            false.update({dtc.fault for dtc in healthy.dtcs})
            pairs = zip(faults, others, strict=True)
            found.update(fault.name for fault, judged in pairs if judged.dtcs)
    return {
        "drives": drives,
        "found": dict(found),
        "false": dict(false),
        "explained": min(explained, default=0.0),
        "severity": {fault.name: fault.severity for fault in faults},
    }


def put_on(
    recording: Recording, fault: Fault, output: str = OUTPUT, transform: str = "phi"
) -> Recording:
    """Return the recording as a faulty sensor would have read the same mixture.

    An output that is not lambda falls where phi rises; the gain acts around its median.
    """
    values, column = recording.values.copy(), recording.names.index(output)
    own, period_s = values[:, column], recording.period_ns / 1e9
    if transform == "phi":
        values[:, column] = faulty_readings(fault, own, period_s)
    else:
        middle = float(np.nanmedian(own))
        small = 0.1 / max(float(np.nanmax(np.abs(own - middle))), 1e-9)  # keeps phi near 1
        phi = 1.0 / faulty_readings(fault, 1.0 / (1.0 - small * (own - middle)), period_s)
        values[:, column] = middle + (1.0 - phi) / small
    return replace(recording, values=values)


def _begin(recording: Recording) -> Recording:
    """Return at most the first hour of a recording."""
    return recording.part(0, round(MOST_S * 1e9 / recording.period_ns))
