"""Localising on simulated vehicles: a simple chain predicts, an effect it lacks is hidden."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize

from monitor.base.types import FloatArray
from tests.helpers.simulated_drives import driven, to_grid
from training.dyno.effects import from_severities
from training.dyno.simulation import Experiment
from training.gap.where.findings import Findings, localise
from training.gap.where.transport import transported
from training.greybox.fit.comparison import Comparison
from training.greybox.fit.drive import Drive, make

PERIOD_S = 0.1
VEHICLE = 2000


def simulated(cycle: str, seed: int, **severities: float) -> Drive:
    signals = driven(
        Experiment(
            cycle=cycle,
            vehicle=VEHICLE,
            seed=seed,
            effects=from_severities(severities),
            duration_s=600.0,
        )
    )
    columns = {name: to_grid(values) for name, values in signals.items()}
    measured = columns.pop("lambda_measured")
    return make(f"{cycle}_s{seed}", PERIOD_S, columns, measured)


def predicted(drive: Drive, constants: FloatArray) -> Comparison:
    """Fuel over air after a dead time with a part that follows the stroke, and one lag."""
    dead_s, per_rpm, lag_s, gain, offset = constants
    ratio = 14.7 * drive.signals["fuel_mass_mg"] / np.maximum(drive.signals["air_mass_mg"], 1.0)
    dead_time_s = np.maximum(
        dead_s + per_rpm * 90.0 / np.maximum(drive.signals["engine_speed_rpm"], 500.0), 0.0
    )
    lag_s = max(lag_s, 0.01)
    at_sensor = transported(np.clip(ratio, 0.0, 2.0), dead_time_s, lag_s, PERIOD_S)
    return Comparison(
        name=drive.name,
        period_s=PERIOD_S,
        signals=drive.signals,
        phi_measured=drive.phi_measured,
        phi_predicted=gain * at_sensor + offset,
        scored=drive.scored,
        dead_time_s=dead_time_s,
        lag_s=lag_s,
    )


@cache
def healthy() -> tuple[tuple[Comparison, ...], tuple[float, ...]]:
    drives = [simulated(c, 2_000_000 + i) for i, c in enumerate(("us06", "udds", "wltc_3b"))]

    def error(constants: FloatArray) -> float:
        return sum(float((predicted(d, constants).residual ** 2).sum()) for d in drives)

    start = np.array([0.1, 1.0, 0.1, 0.9, 0.1])
    best = minimize(error, start, method="Nelder-Mead", options={"maxiter": 300}).x
    return tuple(predicted(d, best) for d in drives), tuple(best)


@cache
def localised(effect: str, first_seed: int = 2_000_100) -> Findings:
    known, constants = healthy()
    hidden = {effect: 4.0} if effect else {}
    drives: Sequence[Drive] = [
        simulated(c, first_seed + i, **hidden) for i, c in enumerate(("us06", "udds", "wltc_3b"))
    ]
    return localise([predicted(d, np.array(constants)) for d in drives], known)


@pytest.mark.parametrize(
    ("effect", "words", "point"),
    [
        ("wall_film", ("rate of fuel", "rate of load"), "before the transport"),
        ("delay_flow", ("load × engine speed", "air flow", "1 / air flow"), "timing"),
    ],
)
def test_a_hidden_effect_is_found_where_its_physics_says(
    effect: str, words: tuple[str, ...], point: str
) -> None:
    result = localised(effect)
    best = [result.regimes[0], *result.rivals]
    assert result.regimes[0].significant
    assert any(r.words.startswith(words) and r.point == point for r in best)
    assert result.excess.low > 0.0


def test_the_same_vehicle_without_an_effect_has_no_finding() -> None:
    for first_seed in (2_000_200, 2_000_300):
        result = localised("", first_seed)
        assert result.significant == ()
