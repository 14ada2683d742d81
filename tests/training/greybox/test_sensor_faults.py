"""Faults of the sensor after the chain, beside the monitor's definitions."""

import numpy as np
import pytest

from monitor.base import faults
from tests.helpers.gap.gap_drives import BASE, PERIOD_S, plain_signals
from training.greybox.chain import base_path, simulate
from training.greybox.fit.sensor_faults import FAULTS

FAULT = {fault.name: fault for fault in FAULTS}


@pytest.mark.parametrize(
    ("name", "severity"),
    [
        ("slow_rich_to_lean", 0.4),
        ("slow_lean_to_rich", 0.4),
        ("slow_symmetric", 0.4),
        ("delay_rich_to_lean", 0.4),
        ("delay_lean_to_rich", 0.4),
        ("delay_symmetric", 0.4),
        ("gain_low", 0.6),
        ("biased_lean", 0.05),
    ],
)
def test_a_sensor_fault_reads_as_the_monitors_definition_does(name: str, severity: float) -> None:
    phi = simulate(base_path(BASE, plain_signals()), PERIOD_S)
    fault = faults.resolve(name, severity)
    rival = FAULT["biased" if name.startswith("biased") else name]
    ours = rival.read(phi, np.array([severity]), PERIOD_S)
    steps = round(fault.delay_s / PERIOD_S)
    slow, wanted = phi[0], np.empty_like(phi)
    for k in range(len(phi)):
        u = faults.one_sided(phi[k], phi[max(k - steps, 0)], fault.delay_direction)
        slow = faults.lag_step(slow, u, fault.tau_rising_s, fault.tau_falling_s, PERIOD_S)
        reading = 1.0 / max(1.0 + fault.gain * (slow - 1.0), 1.0 / 16.0) + fault.offset_lambda
        wanted[k] = 1.0 / min(max(reading, 0.5), 16.0)
    above = wanted > 0.07  # the monitor sends no more than 16 in lambda
    np.testing.assert_allclose(ours[above], wanted[above], atol=1e-9)
