"""The inputs of a model where the user names none: signals of all recordings that move.

The paper's seven inputs are taken where they are. Other vehicles have other signals for the same
causes: fuel, charge, speed and temperature. Of each cause the best signal that is there is taken.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.signals import NARX_INPUTS

if TYPE_CHECKING:
    from training.recordings.recording import Recording

# causes of lambda; of each the first signal that is there
CAUSES: Final = (
    ("fuel_mass_mg", "injector_pulse_width_ms"),
    ("air_mass_mg", "load_g_per_rev", "maf_kg_h"),
    ("maf_kg_h",),
    ("manifold_pressure_kpa",),
    ("engine_speed_rpm",),
    ("manifold_temperature_degc",),
    ("lambda_controller",),
)
# without fuel these tell that fuel is enriched or cut
WITHOUT_FUEL: Final = (("throttle_percent",), ("lambda_target",))
# least range of a signal in the recordings together: intake air follows the weather, and a model
# that learned a few kelvin judges no other day
RANGE_LEAST: Final = {"manifold_temperature_degc": 25.0}
LEAST: Final = 2  # inputs of a model
MOVES: Final = 1e-6  # of its mean: the spread of a signal that is not constant


def choose_inputs(recordings: "Sequence[Recording]", output: str) -> tuple[str, ...]:
    """Return the inputs of a NARX for recordings.

    Raises RecordingError if fewer than two signals are in all of them.
    """
    common = frozenset.intersection(*(moving(each) for each in recordings)) - {output}
    known = frozenset.intersection(*(each.known for each in recordings))
    if frozenset(NARX_INPUTS) <= known:
        return NARX_INPUTS
    for name, least in RANGE_LEAST.items():
        columns = [each.column(name) for each in recordings if name in common]
        if columns and max(map(np.nanmax, columns)) - min(map(np.nanmin, columns)) < least:
            common -= {name}
    causes = CAUSES if common & {*CAUSES[0]} else (*CAUSES, *WITHOUT_FUEL)
    found = (next((name for name in cause if name in common), None) for cause in causes)
    inputs = tuple(dict.fromkeys(name for name in found if name is not None))
    if len(inputs) < LEAST:
        wanted = ", ".join(dict.fromkeys(name for cause in causes for name in cause))
        raise RecordingError(
            f"{recordings[0].path}: no inputs for a model; {LEAST} or more that move are wanted of "
            f"{wanted}; all recordings have {', '.join(sorted(known)) or 'no signal'}; "
            "--columns says which column is which signal, --inputs names others"
        )
    return inputs


def moving(recording: "Recording") -> frozenset[str]:
    """Return the signals that have values and are not constant."""
    found = set()
    for i, name in enumerate(recording.names):
        values = recording.values[:, i]
        values = values[np.isfinite(values)]
        if len(values) and values.std() > MOVES * max(1.0, abs(float(values.mean()))):
            found.add(name)
    return frozenset(found)


def in_words(inputs: Sequence[str]) -> str:
    """Return the sentence that says which inputs were chosen."""
    return f"inputs: {' '.join(inputs)} (chosen from what all recordings have; --inputs changes it)"
