"""Targets of the monitor, and the severity from which it must find a fault."""

from typing import Final

LIMIT_SEVERITY: Final = {
    "slow_rich_to_lean": 0.5,  # s
    "slow_lean_to_rich": 0.5,
    "slow_symmetric": 0.5,
    "delay_rich_to_lean": 0.4,  # s
    "delay_lean_to_rich": 0.4,
    "delay_symmetric": 0.4,
    "transient": 0.5,  # s, with reduced amplitude
    "gain_low": 0.6,  # remaining amplitude, -
    "biased_lean": 0.05,  # lambda
    "biased_rich": 0.05,
}
DETECTED: Final = 0.99  # share of trials, within one WLTC
NAMED: Final = 0.95  # share of trials with exactly the right name
MEDIAN_ENABLED_S: Final = 60.0
COMPLETED: Final = 0.95  # share of healthy WLTCs
HEALTHY_DRIVES, HEALTHY_VEHICLES = 500, 50  # fewest, without any false code


def at_limit(fault: str, severity: float) -> bool:
    """Return whether a fault has exactly its limit severity."""
    return LIMIT_SEVERITY.get(fault) == severity


def beyond_limit(fault: str, severity: float) -> bool:
    """Return whether a fault must be found; False for faults without a limit severity.

    >>> beyond_limit("gain_low", 0.5), beyond_limit("slow_symmetric", 0.3)
    (True, False)
    """
    limit = LIMIT_SEVERITY.get(fault)
    if limit is None:
        return False
    return severity <= limit if fault == "gain_low" else severity >= limit
