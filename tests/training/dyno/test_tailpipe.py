"""What a fault of the upstream sensor costs behind the catalyst of a simulated car."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base.errors import UsageError
from monitor.base.faults import resolve
from training.dyno import tailpipe
from training.dyno.simulation import Experiment
from training.dyno.tailpipe import emitted, limits, proposal
from training.limits.calibration_page import emissions

DRIVES = [Experiment("udds", 8300, 31, duration_s=500.0, downstream=True)]


def test_a_weaker_sensor_lets_more_pass_the_catalyst() -> None:
    sound = max(emitted(DRIVES[0]))
    passed = [
        max(emitted(replace(DRIVES[0], fault=resolve("gain_low", gain)))) for gain in (0.5, 0.25)
    ]
    assert sound < passed[0] < passed[1]


def test_the_limit_lies_where_the_emissions_cross_it(monkeypatch: pytest.MonkeyPatch) -> None:
    # GIVEN emissions of drives over the severity of a weak sensor, and of a lag that costs nothing
    severities = {"gain_low": (0.9, 0.1), "slow_symmetric": (1e-3, 2e-3)}
    monkeypatch.setattr(tailpipe, "SEVERITIES", severities)
    monkeypatch.setattr(tailpipe, "STEPS", 4)
    # WHEN limits are read from them
    found = limits(1.5, DRIVES)
    # THEN one lies between the severities around the crossing, and the other is not told
    weak = found["gain_low"]
    k = int(np.flatnonzero(np.array(weak["multiples"]) > 1.5)[0])
    assert k > 0
    assert weak["severities"][k] <= weak["severity"] <= weak["severities"][k - 1]
    assert weak["of_each_car"] == [weak["severity"]]  # of the only car
    assert found["slow_symmetric"]["severity"] is None


def test_settings_follow_from_the_severest_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    at = dict.fromkeys(tailpipe.SEVERITIES, 1.0) | {"gain_low": None}
    at |= {"slow_rich_to_lean": 0.8, "slow_lean_to_rich": 0.6}
    made = {
        name: {"severity": s, "unit": "s", "of_each_car": [s], "pollutant": "NOx" * bool(s)}
        for name, s in at.items()
    }
    monkeypatch.setattr(tailpipe, "limits", lambda limit: made)
    told = proposal(1.5)
    assert told["source"] == "simulated"
    wanted = {"lag_limit_s": 0.6, "lag_limit_symmetric_s": 1.0, "delay_limit_s": 1.0}
    assert told["response"] == wanted
    rows = {
        ("gain_low", "not reached", "not reached", "-"),
        ("slow_lean_to_rich", "from 0.6 s", "0.6 s", "NOx"),
    }
    assert rows <= set(emissions(told))


def test_a_limit_below_the_healthy_emissions_is_refused() -> None:
    with pytest.raises(UsageError, match="--emission-limit 1: more than 1 is wanted"):
        proposal(1.0)
