"""What the monitor must reach, and from which severity on a fault must be found."""

from typing import Final

LIMIT_SEVERITY: Final = {
    "slow_rich_to_lean": 0.5,  # s
    "slow_lean_to_rich": 0.5,
    "slow_symmetric": 0.5,
    "delay_rich_to_lean": 0.4,  # s
    "delay_lean_to_rich": 0.4,
    "delay_symmetric": 0.4,
    "transient": 0.5,  # s, with reduced amplitude
    "gain_low": 0.6,  # of the amplitude is left
    "biased_lean": 0.05,  # lambda
    "biased_rich": 0.05,
}
DETECTED: Final = 0.99  # of trials within one WLTC
NAMED: Final = 0.95  # of trials, by exactly their name
MEDIAN_ENABLED_S: Final = 60.0
COMPLETED: Final = 0.95  # of healthy WLTCs
HEALTHY_DRIVES, HEALTHY_VEHICLES = 500, 50  # at least, for no false code at all


def at_limit(fault: str, severity: float) -> bool:
    """Return whether a fault is just severe enough that it must be found."""
    return LIMIT_SEVERITY.get(fault) == severity


def beyond_limit(fault: str, severity: float) -> bool:
    """Return whether a fault is so severe that it must be found; electrical ones have no limit.

    >>> beyond_limit("gain_low", 0.5), beyond_limit("slow_symmetric", 0.3)
    (True, False)
    """
    limit = LIMIT_SEVERITY.get(fault)
    if limit is None:
        return False
    return severity <= limit if fault == "gain_low" else severity >= limit
