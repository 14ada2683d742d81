"""The fault memory as data for the page."""

from collections.abc import Mapping
from typing import Any

from monitor.bus.live.describe import value_text, words
from monitor.memory.codes import TESTS
from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import FreezeFrame
from monitor.report.words import advice, meaning


def fault_memory(store: DtcStore) -> dict[str, Any]:
    """Return codes, permanent codes, tests and counts; times are those of the frames, in ns."""
    shown = [dtc for dtc in store.all if dtc.state or dtc.status & Status.FAILED_SINCE_CLEAR]
    frames = store.freeze_frames
    counts = store.counts
    return {
        "mil": store.mil,
        "fault_flag": store.fault_flag,
        "codes": [
            _code(dtc, frames) for dtc in sorted(shown, key=lambda d: (d.state is None, d.code))
        ],
        "permanent": list(store.permanent),
        "tests": [
            {
                "test": ratio.test,
                "complete": store.completed_since_clear(ratio.test),
                "numerator": ratio.numerator,
                "denominator": ratio.denominator,
            }
            for ratio in sorted(store.supported_ratios, key=lambda r: list(TESTS).index(r.test))
        ],
        "counts": {
            "ignition cycles": counts.ignition_cycles,
            "general denominator": counts.general_denominator,
            "warm-ups since clearing": counts.warm_ups_since_clear,
            "distance since clearing": f"{counts.distance_since_clear_km:.1f} km",
            "distance with MIL on": f"{counts.distance_with_mil_km:.1f} km",
            "engine run since clearing": f"{counts.engine_run_since_clear_s / 60.0:.0f} min",
            "engine run with MIL on": f"{counts.engine_run_with_mil_s / 60.0:.0f} min",
        },
    }


def _code(dtc: Dtc, frames: Mapping[str, FreezeFrame]) -> dict[str, Any]:
    frame = frames.get(dtc.code)
    return {
        "code": dtc.code,
        "fault": dtc.fault,
        "also": list(dtc.also),
        "meaning": meaning(dtc.fault, dtc.also),
        "advice": [each._asdict() for _, each in advice([{"code": dtc.code, "fault": dtc.fault}])],
        "state": dtc.state,
        "status": int(dtc.status),
        "bits": [str(bit.name).lower().replace("_", " ") for bit in dtc.status],
        "t_ns": str(dtc.t_ns) if dtc.has_failed else None,
        "frame": frame
        and {
            "t_ns": str(frame.t_ns),
            "values": [[words(n), value_text(n, v)] for n, v in frame.values.items()],
        },
    }
