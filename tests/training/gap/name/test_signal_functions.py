"""Plain functions of recorded signals."""

from dataclasses import replace

import numpy as np

from tests.helpers.gap.gap_drives import noisy_drive
from training.gap.name.formulas.signal_functions import functions_of


def test_flags_answers_and_what_differs_between_drives_alone_are_no_functions() -> None:
    drives = []
    for i, drive in enumerate((noisy_drive(1), noisy_drive(2))):
        more = {
            "ambient_temperature_degc": np.full(len(drive), 10.0 * i),
            "lambda_controller": 1.0 + 0.01 * np.sin(np.arange(len(drive))),
            "closed_loop": (np.arange(len(drive)) % 100 > 50).astype(float),
        }
        drives.append(replace(drive, signals=dict(drive.signals) | more))
    found = {function.signal for function in functions_of(drives)}
    assert {"engine_speed_rpm", "coolant_temperature_degc"} <= found
    assert not found & {*more, "ambient_pressure_kpa", "fuel_mass_mg"}
