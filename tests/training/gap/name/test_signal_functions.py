"""Plain functions of recorded signals."""

from dataclasses import replace

import numpy as np

from tests.helpers.gap.gap_drives import noisy_drive
from training.gap.name.formulas.signal_functions import functions_of


def test_flags_answers_and_what_differs_between_drives_alone_are_no_functions() -> None:
    drives = [noisy_drive(seed) for seed in (1, 2)]
    weather = [
        replace(
            d,
            signals=dict(d.signals)
            | {
                "ambient_temperature_degc": np.full(len(d), 10.0 * i),
                "lambda_controller": 1.0 + 0.01 * np.sin(np.arange(len(d))),
                "closed_loop": (np.arange(len(d)) % 100 > 50).astype(float),
            },
        )
        for i, d in enumerate(drives)
    ]
    found = {function.signal for function in functions_of(weather)}
    assert {"engine_speed_rpm", "coolant_temperature_degc"} <= found
    assert not found & {
        "ambient_temperature_degc",
        "ambient_pressure_kpa",
        "lambda_controller",
        "closed_loop",
        "fuel_mass_mg",
    }
