"""The catalyst monitor: samples in, verdicts on catalyst and downstream sensor out.

It works where the samples hold upstream lambda, the air flow and a downstream sensor, from its
first good reading on. The lambda of a wide-range downstream sensor is turned into the voltage of a
switching one; its circuit is not judged. Samples that are missing for a moment are bridged with the
last values; after a longer gap the filling of the catalyst is found anew.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from monitor.base.config import CatalystConfig, Config
from monitor.base.types import BoolArray, FloatArray
from monitor.judge.catalyst.bank import LEAK, MID_V, switching_volts
from monitor.judge.catalyst.rear_circuit import CIRCUIT, HEATER, RearCircuit
from monitor.judge.catalyst.rule import CatalystRule
from monitor.judge.window import Opinion
from monitor.memory.obd_records import TestResult

VOLTAGE: Final = "downstream_voltage_v"
WIDE: Final = "downstream_lambda"  # of a wide-range sensor in its place
REAR: Final = (VOLTAGE, WIDE)
UPSTREAM: Final = ("lambda_measured", "maf_kg_h")
NEEDED: Final = (VOLTAGE, *UPSTREAM)
DUTY: Final = "downstream_heater_percent"
SIGNALS: Final = (*REAR, *UPSTREAM, "catalyst_temperature_degc", DUTY, "engine_speed_rpm")
KG_H_PER_G_S: Final = 3.6


class BehindResult(NamedTuple):
    """How the evidence of one test stands at a sample."""

    at: int
    test: str  # "catalyst", "downstream", "balance", "bias" or one of circuit and heater
    claim: Opinion
    capacity_g: float | None = None  # estimate so far
    results: tuple[TestResult, ...] = ()  # for service $06


def rule_results(at: int, rule: CatalystRule, config: CatalystConfig) -> Iterator[BehindResult]:
    """Yield how the evidence of each test stands at the end of a segment."""
    grams = rule.capacity().grams
    measured = tuple(_estimates(rule, grams, config))
    yield BehindResult(at, "catalyst", rule.catalyst(), grams, measured)
    yield BehindResult(at, "downstream", rule.sensor(), grams)
    for test, claim in _of_balance(rule.balance()):
        yield BehindResult(at, test, claim, grams)


def _of_balance(claim: Opinion) -> Iterator[tuple[str, Opinion]]:
    """Yield the meanings of an upstream reading against the balance, each with its test.

    The ECU follows the upstream sensor: where it reads lean the mixture is rich, and the reverse.
    A leak behind the catalyst is no fault of the sensor.
    """
    balance = {"biased_lean": "balance_rich", "biased_rich": "balance_lean", LEAK: "balance_lean"}
    if claim.outcome != "failed":
        yield "balance", claim
        return
    fault = claim.fault or ""
    named = fault, *claim.also
    sets_sensor = LEAK not in named
    also = () if sets_sensor else tuple(name for name in named if name != LEAK)
    yield "balance", replace(claim, fault=balance[fault], also=also)
    if sets_sensor:
        yield "bias", replace(claim, also=())


def _estimates(rule: CatalystRule, grams: float, config: CatalystConfig) -> Iterator[TestResult]:
    """Yield the estimates of capacity and downstream sensor so far, with their limits."""
    threshold_g, most_g = config.threshold_g, config.capacities_g[-1]
    yield TestResult("catalyst", "capacity_g", grams, threshold_g, most_g)
    most = most_g / threshold_g
    yield TestResult("catalyst", "capacity_over_threshold", grams / threshold_g, 1.0, most)
    # a lag halfway between the slowest sound sensor and the quickest slow one, in octaves
    limit_s = math.sqrt(max(config.sensor_sound_lags_s) * min(config.sensor_slow_lags_s))
    for edge, lag_s in rule.sensor_lags().items():
        yield TestResult("downstream", f"lag_{edge}_s", lag_s, 0.0, limit_s)
    yield TestResult("downstream", "least_v", rule.low_v, config.circuit_low_v, config.lean_v)
    rich_v = 2.0 * MID_V - config.lean_v
    yield TestResult("downstream", "most_v", rule.high_v, rich_v, config.circuit_high_v)
    sound = config.offset_sound_phi
    yield TestResult("balance", "upstream_offset_phi", -rule.offset()[0], -sound, sound)


class CatalystMonitor:
    """Judges catalyst and downstream sensor of one vehicle, sample by sample.

    names : signals of a sample
    """

    def __init__(self, settings: Config, names: Sequence[str], period_s: float) -> None:
        self._settings, self._config = settings, settings.catalyst
        at = {name: i for i, name in enumerate(names)}
        self._rear = [at[name] for name in REAR if name in at]
        self._places = [at[name] for name in UPSTREAM if name in at]
        self._is_possible = len(self._places) == len(UPSTREAM) and bool(self._rear)
        self._brick, self._duty = at.get("catalyst_temperature_degc"), at.get(DUTY)
        self._wide = at.get(WIDE)
        self._sensor, self._is_wide = 0, False  # column of the downstream sensor that is heard
        self._period_s = period_s
        self._n_hold = round(self._config.hold_s / period_s)
        self._n_warm_up = round(self._config.warm_up_s / period_s)
        self.rule: CatalystRule | None = None  # from the first good reading on
        self.reset()

    def reset(self) -> None:
        """Begin as after switching on."""
        if self.rule is not None:
            self.rule = self._rule_of(self._sensor)
        self.circuit = RearCircuit(self._settings, self._period_s)
        self._last = [math.nan] * len(NEEDED)
        self._missing = 0  # samples in a row with a value missing
        self._running = 0  # samples with the engine running

    def push(self, values: FloatArray, running: BoolArray) -> Iterator[BehindResult]:
        """Yield the verdicts that samples allow; all of them must be taken.

        values : (n, n_names)
        running : (n,) whether the engine runs
        """
        samples = zip(values.tolist(), running.tolist(), strict=True) if self._is_possible else ()
        for k, (sample, runs) in enumerate(samples):
            self._running += runs
            rear = (i for i in self._rear if math.isfinite(sample[i]))
            if self.rule is None and (sensor := next(rear, None)) is not None:
                self.rule = self._rule_of(sensor)
            yield from self._judged(k, sample, runs=runs)

    def _rule_of(self, sensor: int) -> CatalystRule:
        self._sensor, self._is_wide = sensor, sensor == self._wide
        if self._is_wide:
            self._config = replace(self._config, switching_phi=self._config.wide_phi)
        settings = replace(self._settings, catalyst=self._config)
        return CatalystRule(settings, self._period_s, wide=self._is_wide)

    def _judged(self, k: int, sample: Sequence[float], *, runs: bool) -> Iterator[BehindResult]:
        """Yield how the evidence stands after a sample; with the engine off sensors cool down."""
        volts, *upstream = own = [sample[i] for i in (self._sensor, *self._places)]
        if self._is_wide:
            own[0] = float(switching_volts(np.asarray(_x_of(volts)), self._config))
        before, is_complete = self._last, all(map(math.isfinite, own))
        self._missing = 0 if is_complete else self._missing + 1
        pairs = zip(own, before, strict=True)
        held = self._last = [new if math.isfinite(new) else old for new, old in pairs]
        if self.rule is None:
            return
        for test, found in self.circuit.push(
            volts=math.nan if self._is_wide else volts,
            x=_x_of(upstream[0]),
            air_g_s=upstream[1] / KG_H_PER_G_S,
            running=self._running if runs else 0,
            duty_percent=math.nan if self._duty is None else sample[self._duty],
        ):
            wake_s, most_s = self.circuit.wake_s, self._config.wake_most_s  # from a cold start
            woke = (TestResult(HEATER, "wake_s", wake_s, 0.0, most_s),) if wake_s else ()
            yield BehindResult(k, test, found, results=woke)
        if self._missing == self._n_hold + 1:
            self.rule.interrupt()
        if self._missing > self._n_hold or not all(map(math.isfinite, held)):
            return
        air_g_s = held[2] / KG_H_PER_G_S
        is_believed = self._is_wide or not self.circuit.is_doubtful
        counts = runs and is_complete and self._is_warm(sample) and is_believed
        counts = counts and air_g_s <= self._config.flow_most_g_s
        x = self._entering(_x_of(held[1]), _x_of(before[1]))
        if self.rule.push(x, air_g_s, held[0], counts=counts):
            yield from rule_results(k, self.rule, self._config)

    def _entering(self, x: float, before: float) -> float:
        """Return x of the gas that the upstream sensor follows with its lag.

        x : as measured; before : of the sample before, nan if there is none
        """
        lag_s, most = self._config.upstream_lag_s, self._config.upstream_lag_most_phi
        lead = 0.0 if math.isnan(before) else lag_s * ((x - before) / self._period_s)
        return min(x + min(max(lead, -most), most), 1.0)

    def _is_warm(self, sample: Sequence[float]) -> bool:
        """Return whether the brick is warm, by its temperature or by running time."""
        degc = math.nan if self._brick is None else sample[self._brick]
        if math.isnan(degc):
            return self._running >= self._n_warm_up
        return degc >= self._config.warm_degc

    @property
    def supported(self) -> tuple[str, ...]:
        """Return the tests behind the catalyst that the signals so far allow."""
        if self.rule is None:
            return ()
        circuit = () if self._is_wide else (CIRCUIT,)
        heater = (HEATER,) if self.circuit.can_judge_heater else ()
        return ("catalyst", "downstream", "balance", *circuit, *heater)

    def entry(self) -> dict[str, Any] | None:
        """Return the report's entry of the catalyst, None without a downstream sensor."""
        if self.rule is None:
            return None
        rule, (offset, offset_std) = self.rule, self.rule.offset()
        capacity = rule.capacity() if rule.segments else None
        claims = {"": rule.catalyst(), "sensor_": rule.sensor(), "balance_": rule.balance()}
        is_bound = capacity is not None and capacity.is_bound
        found: dict[str, Any] = {
            "segments": rule.segments,
            "threshold_g": self._config.threshold_g,
            "capacity_g": capacity and round(capacity.grams, 4),
            "capacity_low_g": capacity and round(capacity.low_g, 4),
            "capacity_high_g": None if is_bound else capacity and round(capacity.high_g, 4),
            "capacity_is_bound": is_bound,
        }
        for of, claim in claims.items():
            found |= {f"{of}verdict": claim.outcome, f"{of}log_odds": round(claim.log_odds, 3)}
        return found | {
            "upstream_offset_lambda": round(-offset, 5),
            "upstream_offset_std": round(offset_std, 5),
            "needed": round(self._settings.response.evidence_fail, 3),
        }


def _x_of(lambda_upstream: float) -> float:
    return 1.0 - 1.0 / max(lambda_upstream, 0.1)
