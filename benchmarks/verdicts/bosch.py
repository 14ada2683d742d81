"""Runs of the Bosch engines, and sensor faults put on them afterwards.

Real recordings (boschresearch/Bosch-Engine-Datasets, CC BY-SA 4.0; 10 Hz, z-scored by their
authors), a folder ``bosch_gengine1`` or ``bosch_gengine2`` for each engine. The faults are added to
the measured lambda, so the control loop did not see them.

The scale of z is not published. Lambda saturates at z = 7.746 and stays at -0.065 in closed loop.
If the first is lambda 1.5 and the second lambda 1, one z is 0.064 lambda. Offsets use this scale;
lags, dead times and gains need none, and the gain acts around z = -0.065.
"""

from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.faults import Fault, lag_step, one_sided
from monitor.base.types import FloatArray
from training.recordings.recording import Recording, load

INPUTS: Final = ("speed_z", "load_z", "ignition_angle_z", "fuel_cutoff_z")
OUTPUT: Final = "lambda_z"
RUNS: Final = {1: (10, 11, 12, 13, 14, 15, 30, 31, 32, 33, 53, 54), 2: (3, 6, 8, 11, 15, 19)}
STOICHIOMETRIC_Z: Final = -0.065  # median of all runs outside fuel cut
LAMBDA_PER_Z: Final = 0.064  # see above
# maps the fuel cut-off to the enable conditions, so that windows exclude fuel cut and the recovery;
# z = -0.11644 is no cut; the channel is binary, so z * std + mean = 0 or 1
MASK: Final = """
time_s = "time_s"
speed_z = "speed_z"
load_z = "load_z"
ignition_angle_z = "ignition_angle_z"
fuel_cutoff_z = "fuel_cutoff_z"
lambda_z = "lambda_z"
fuel_cut = { column = "fuel_cutoff_z", factor = 0.11365, offset = 0.0132335 }
"""


def path_of(folder: Path, engine: int, run: int) -> Path:
    """Return the file of a run."""
    return folder / f"bosch_gengine{engine}" / f"run_{run:06d}.csv.gz"


def run_of(folder: Path, engine: int, run: int, columns: Path | None = None) -> Recording:
    """Return a run."""
    return load(path_of(folder, engine, run), columns=columns)


def faulty(values: FloatArray, fault: Fault, period_s: float) -> FloatArray:
    """Return what the faulty sensor reads, (n,) z; rising phi is falling z."""
    u = STOICHIOMETRIC_Z - values
    late = round(fault.delay_s / period_s)
    delayed = np.concatenate([np.full(late, u[0]), u[: len(u) - late]])
    x, read = float(u[0]), np.empty(len(u))
    for k in range(len(u)):
        seen = one_sided(float(u[k]), float(delayed[k]), fault.delay_direction)
        x = lag_step(x, seen, fault.tau_rising_s, fault.tau_falling_s, period_s)
        read[k] = fault.gain * x
    return np.asarray(STOICHIOMETRIC_Z - read + fault.offset_lambda / LAMBDA_PER_Z)
