"""Targets of the monitor."""

from typing import Final

from monitor.base.faults import LIMIT_SEVERITY

__all__ = ["LIMIT_SEVERITY", "at_limit", "beyond_limit"]

DETECTED: Final = 0.99  # least share of trials detected within one WLTC
NAMED: Final = 0.95  # least share of trials with exactly the right name
MEDIAN_ENABLED_S: Final = 60.0  # longest median enabled time to the code
COMPLETED: Final = 0.95  # least share of healthy WLTCs with a completed test
HEALTHY_DRIVES, HEALTHY_VEHICLES = 500, 50  # least numbers that must stay without a false code


def at_limit(fault: str, severity: float) -> bool:
    """Return whether the severity is the limit severity of the fault."""
    return LIMIT_SEVERITY.get(fault) == severity


def beyond_limit(fault: str, severity: float) -> bool:
    """Return whether the monitor must detect a fault of this severity.

    The answer is False for electrical faults, which have no limit severity.

    >>> beyond_limit("gain_low", 0.5), beyond_limit("slow_symmetric", 0.3)
    (True, False)
    """
    limit = LIMIT_SEVERITY.get(fault)
    if limit is None:
        return False
    return severity <= limit if fault == "gain_low" else severity >= limit
