"""Results of the tests behind the catalyst with their limits, as service $06 reports them."""

import math
from collections.abc import Iterator

import numpy as np

from monitor.base.config import CatalystConfig
from monitor.judge.catalyst.rear_circuit import HEATER, CircuitResult
from monitor.judge.catalyst.rule import CatalystRule
from monitor.memory.obd_records import TestResult


def rule_results(rule: CatalystRule, config: CatalystConfig) -> Iterator[TestResult]:
    """Yield the estimates of capacity and downstream sensor so far."""
    capacity, threshold_g = rule.capacity(), config.threshold_g
    if capacity is None:
        return
    grams, most_g = capacity.grams, config.capacities_g[-1]
    yield TestResult("catalyst", "capacity_g", grams, threshold_g, most_g)
    most = most_g / threshold_g
    yield TestResult("catalyst", "capacity_over_threshold", grams / threshold_g, 1.0, most)
    # a lag halfway between the slowest sound sensor and the quickest slow one, in octaves
    limit_s = math.sqrt(max(config.sensor_sound_lags_s) * min(config.sensor_slow_lags_s))
    for edge, lag_s in rule.sensor_lags().items():
        yield TestResult("downstream", f"lag_{edge}_s", lag_s, 0.0, limit_s)
    low_v, high_v = rule.range_v
    if np.isfinite([low_v, high_v]).all():
        yield TestResult("downstream", "least_v", low_v, config.circuit_low_v, config.lean_v)
        yield TestResult("downstream", "most_v", high_v, config.rich_v, config.circuit_high_v)
    sound = config.offset_sound_phi
    yield TestResult("balance", "upstream_offset_phi", -rule.offset(), -sound, sound)


def circuit_results(result: CircuitResult, config: CatalystConfig) -> Iterator[TestResult]:
    """Yield after how long the downstream sensor woke, where a cold start was seen."""
    if result.wake_s is not None:
        yield TestResult(HEATER, "wake_s", result.wake_s, 0.0, config.wake_most_s)
