"""The capacity between those of the bank, and its interval."""

import numpy as np
import pytest

from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.catalyst.estimate import CapacityCurve

LOG_G = np.log(np.array(config.shipped().catalyst.capacities_g))
PARTS = 8


def evidence(grams: float, width: float) -> FloatArray:
    """Log likelihood at the bank's capacities of a drive that tells ``grams`` within ``width``."""
    return np.asarray(-0.5 * ((LOG_G - np.log(grams)) / width) ** 2)


@pytest.mark.parametrize("grams", [0.052, 0.1, 0.3, 0.32, 0.44, 0.6])
def test_a_capacity_between_two_of_the_bank_is_estimated_where_it_is(grams: float) -> None:
    # GIVEN evidence that is narrower than the steps of the bank
    own = evidence(grams, 0.06)
    found = CapacityCurve(LOG_G).estimate(own, np.tile(own, (PARTS, 1)), shared=0.0)
    assert found.grams == pytest.approx(grams, rel=0.03)
    assert found.low_g < grams < found.high_g
    assert found.high_g / found.low_g == pytest.approx(np.exp(2 * 1.645 * 0.06), rel=0.1)


def test_stretches_that_disagree_widen_the_interval() -> None:
    curve, own = CapacityCurve(LOG_G), evidence(0.3, 0.06)
    alike = np.tile(own, (PARTS, 1))
    apart = np.array([evidence(0.3 * np.exp(0.03 * (-1) ** i), 0.06) for i in range(PARTS)])
    widths = [
        np.log(f.high_g / f.low_g) for f in (curve.estimate(own, w, 0.0) for w in (alike, apart))
    ]
    spread = np.sqrt((PARTS - 1) * 0.03**2)  # of the jackknife
    assert widths[1] == pytest.approx(np.hypot(widths[0], 2 * 1.645 * spread), rel=0.05)


def test_evidence_without_an_upper_end_is_a_bound() -> None:
    own = np.where(np.log(0.6) > LOG_G, -50.0, 0.0)
    found = CapacityCurve(LOG_G).estimate(own, np.tile(own, (PARTS, 1)), shared=0.05)
    assert found.is_bound
    assert 0.4 < found.low_g < 0.8
