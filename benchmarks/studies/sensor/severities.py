"""Faults of the detection matrix, their severities, and those that the monitor must detect."""

from typing import Final

from monitor.base import faults
from monitor.base.errors import UsageError

SLOW, DELAY = (0.2, 0.3, 0.5, 0.7, 1.0, 2.0), (0.2, 0.3, 0.4, 0.6, 1.0, 2.0)  # s
BIAS = (0.02, 0.035, 0.05, 0.07, 0.1, 0.2)  # lambda
ELECTRICAL: Final = (
    "stuck_lean",
    "stuck_rich",
    "stuck_at_one",
    "no_activity",
    "intermittent",
    "drift_lean",
    "drift_rich",
    "out_of_range",
    "not_ready",
    "signal_missing",
    "heater",
)
# the ECU sends them, no reading shows them
NOT_AFTERWARDS: Final = ("not_ready", "signal_missing", "heater")
LIMIT_SEVERITY: Final = {  # from which the monitor must detect a fault
    "slow_rich_to_lean": 0.5,  # s
    "slow_lean_to_rich": 0.5,
    "slow_symmetric": 0.5,
    "delay_rich_to_lean": 0.4,  # s
    "delay_lean_to_rich": 0.4,
    "delay_symmetric": 0.4,
    "transient": 0.5,  # s, together with a reduced amplitude
    "gain_low": 0.6,  # remaining share of the amplitude
    "biased_lean": 0.05,  # lambda
    "biased_rich": 0.05,
}
SEVERITIES: Final[dict[str, tuple[float, ...]]] = {
    **{name: SLOW for name in faults.NAMES if name.startswith("slow")},
    **{name: DELAY for name in faults.NAMES if name.startswith("delay")},
    "transient": (0.3, 0.5, 1.0),
    "gain_low": (0.8, 0.7, 0.6, 0.5, 0.3),
    "biased_lean": BIAS,
    "biased_rich": BIAS,
    **{name: (faults.DEFAULT_SEVERITY[name],) for name in ELECTRICAL},
}


def severities_of(text: str) -> tuple[str, tuple[float, ...]]:
    """Return name and severities of ``NAME`` or ``NAME=SEVERITY,…``.

    >>> severities_of("gain_low=0.6,0.5")
    ('gain_low', (0.6, 0.5))
    """
    name, _, values = text.partition("=")
    if name not in SEVERITIES:
        raise UsageError(f"fault {name!r} is unknown; there are {', '.join(SEVERITIES)}")
    try:
        return name, tuple(map(float, values.split(","))) if values else SEVERITIES[name]
    except ValueError:
        raise UsageError(f"{text!r}: wanted NAME=SEVERITY,…") from None


def at_limit(fault: str, severity: float) -> bool:
    """Return whether the severity is the limit severity of the fault."""
    return LIMIT_SEVERITY.get(fault) == severity


def beyond_limit(fault: str, severity: float) -> bool:
    """Return whether the monitor must detect a fault of this severity; False if electrical.

    >>> beyond_limit("gain_low", 0.5), beyond_limit("slow_symmetric", 0.3)
    (True, False)
    """
    limit = LIMIT_SEVERITY.get(fault)
    if limit is None:
        return False
    return severity <= limit if fault == "gain_low" else severity >= limit
