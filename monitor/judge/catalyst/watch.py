"""The catalyst monitor: samples in, verdicts on catalyst and downstream sensor out.

It works where the samples hold upstream lambda, the air flow and a downstream sensor, from its
first good reading on. The lambda of a wide-range downstream sensor is turned into the voltage of a
switching one; its circuit is not judged. Samples that are missing for a moment are bridged with the
last values; after a longer gap the filling of the catalyst is found anew.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from monitor.base.config import CatalystConfig, Config
from monitor.base.types import BoolArray, FloatArray, IntArray
from monitor.judge.catalyst.bank import LEAK, switching_volts
from monitor.judge.catalyst.rear_circuit import CIRCUIT, HEATER, CircuitResult, RearCircuit
from monitor.judge.catalyst.rule import CatalystRule, Claim
from monitor.memory.obd_records import TestResult

VOLTAGE: Final = "downstream_voltage_v"
WIDE: Final = "downstream_lambda"  # of a wide-range sensor in its place
REAR: Final = (VOLTAGE, WIDE)
UPSTREAM: Final = ("lambda_measured", "maf_kg_h")
NEEDED: Final = (VOLTAGE, *UPSTREAM)
DUTY: Final = "downstream_heater_percent"
SIGNALS: Final = (
    *REAR,
    *UPSTREAM,
    "catalyst_temperature_degc",
    DUTY,
    "engine_speed_rpm",
)
KG_H_PER_G_S: Final = 3.6


class BehindResult(NamedTuple):
    """How the evidence of one test stands at a sample."""

    at: int
    test: str  # "catalyst", "downstream", "balance", "bias" or one of circuit and heater
    claim: Claim
    capacity_g: float | None = None  # estimate so far
    results: tuple[TestResult, ...] = ()  # for service $06


def balance_results(at: int, claim: Claim) -> Iterator[BehindResult]:
    """Yield the meanings of an upstream reading against the balance.

    The ECU follows the upstream sensor: where it reads lean the mixture is rich, and the reverse.
    A leak behind the catalyst is no fault of the sensor.
    """
    balance = {"biased_lean": "balance_rich", "biased_rich": "balance_lean", LEAK: "balance_lean"}
    if claim.outcome != "failed":
        yield BehindResult(at, "balance", claim)
        return
    fault = claim.fault or ""
    others = tuple(n for n in (fault, *claim.also) if n != LEAK)
    sets_sensor = fault != LEAK and LEAK not in claim.also
    also = () if sets_sensor else others
    yield BehindResult(at, "balance", replace(claim, fault=balance[fault], also=also))
    if sets_sensor:
        yield BehindResult(at, "bias", replace(claim, also=()))


def circuit_claim(result: CircuitResult) -> Claim:
    """Return a decision about circuit or heater as a claim."""
    return Claim("failed" if result.fault else "passed", result.fault or None, 0.0)


def rule_results(rule: CatalystRule, config: CatalystConfig) -> Iterator[TestResult]:
    """Yield the estimates of capacity and downstream sensor so far, with their limits."""
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


class CatalystMonitor:
    """Judges catalyst and downstream sensor of one vehicle; the state goes from block to block.

    names : signals of a sample
    """

    def __init__(self, settings: Config, names: Sequence[str], period_s: float) -> None:
        self._settings, config = settings, settings.catalyst
        at = {name: i for i, name in enumerate(names)}
        has_upstream = all(name in at for name in UPSTREAM)
        self._rear = [at[name] for name in REAR if name in at]
        self.is_possible = has_upstream and bool(self._rear)
        self._places = [at.get(name, 0) for name in UPSTREAM]
        self._brick = at.get("catalyst_temperature_degc")
        self._wide, self._duty = at.get(WIDE), at.get(DUTY)
        self._sensor, self._is_wide = 0, False  # column of the downstream sensor that is heard
        self.circuit = RearCircuit(settings, period_s)
        self._config, self._period_s = config, period_s
        self._n_hold = round(config.hold_s / period_s)
        self._n_warm_up = round(config.warm_up_s / period_s)
        self.rule: CatalystRule | None = None  # from the first good reading on
        self.reset()

    @property
    def is_heard(self) -> bool:
        """Return whether a good reading came, so that there is something to judge."""
        return self.rule is not None

    def reset(self) -> None:
        """Begin as after switching on."""
        if self.rule is not None:
            self.rule.reset()
        self.circuit.reset()
        self._last = np.full(len(NEEDED), np.nan)
        self._missing = 0  # samples in a row with a value missing
        self._running = 0  # samples with the engine running

    def push(self, values: FloatArray, running: BoolArray) -> Iterable[BehindResult]:
        """Return the verdicts that samples allow; all of them must be taken.

        values : (n, n_names)
        running : (n,) whether the engine runs
        """
        if not self.is_possible or not len(values):
            return ()
        if self.rule is None:
            good = np.isfinite(values[:, self._rear])
            if not good.any():
                self._running += int(np.count_nonzero(running))
                return ()
            first = good[good.any(axis=1).argmax()]  # row of the first reading
            self.rule = self._rule_of(self._rear[int(first.argmax())])
        return self._heard(self.rule, values, running)

    def _rule_of(self, sensor: int) -> CatalystRule:
        """Return the rule for the downstream sensor in this column."""
        self._sensor, self._is_wide = sensor, sensor == self._wide
        if self._is_wide:
            self._config = replace(self._config, switching_phi=self._config.wide_phi)
        settings = replace(self._settings, catalyst=self._config)
        return CatalystRule(settings, self._period_s, wide=self._is_wide)

    def _heard(
        self, rule: CatalystRule, values: FloatArray, running: BoolArray
    ) -> Iterator[BehindResult]:
        run = self._running + np.cumsum(running)
        self._running = run.item(-1)
        own = values.take([self._sensor, *self._places], axis=1)
        unknown = np.full(len(values), np.nan)
        volts = unknown if self._is_wide else own[:, 0]
        if self._is_wide:
            own[:, 0] = switching_volts(_x_of(own[:, 0]), self._config)
        found, doubtful = self.circuit.push(
            volts=volts,
            x=_x_of(own[:, 1]),
            air_g_s=own[:, 2] / KG_H_PER_G_S,
            running=run,
            duty_percent=unknown if self._duty is None else values[:, self._duty],
        )
        for each in found:
            measured = () if each.wake_s is None else (self._wake(each.wake_s),)
            yield BehindResult(each.at, each.test, circuit_claim(each), results=measured)
        yield from self._judged(rule, own, self._warm(values, run) & ~doubtful)

    def _wake(self, wake_s: float) -> TestResult:
        """Return after how long the downstream sensor woke from a cold start."""
        return TestResult(HEATER, "wake_s", wake_s, 0.0, self._config.wake_most_s)

    def _judged(
        self, rule: CatalystRule, own: FloatArray, fit: BoolArray
    ) -> Iterator[BehindResult]:
        """Yield how the evidence stands; ``fit`` says which samples may be judged."""
        good, before = np.isfinite(own), _x_of(self._last[1:2])
        held, usable = self._held(own, good)
        x = self._entering(_x_of(held[:, 1]), before)
        air_g_s = held[:, 2] / KG_H_PER_G_S
        counts = fit & good.all(axis=1) & (air_g_s <= self._config.flow_most_g_s)
        begin, edges = 0, [*(np.flatnonzero(np.diff(usable)) + 1).tolist(), len(usable)]
        for end in edges:
            part = slice(begin, end)
            if not usable[begin]:
                rule.interrupt()
            else:
                for k in rule.push(x[part], air_g_s[part], held[part, 0], counts[part]):
                    at, capacity = begin + k, rule.capacity()
                    grams = capacity.grams if capacity else None
                    measured = tuple(rule_results(rule, self._config))
                    yield BehindResult(at, "catalyst", rule.catalyst(), grams, measured)
                    yield BehindResult(at, "downstream", rule.sensor(), grams)
                    for each in balance_results(at, rule.balance()):
                        yield each._replace(capacity_g=grams)
            begin = end

    def _entering(self, x: FloatArray, before: FloatArray) -> FloatArray:
        """Return x of the gas that the upstream sensor follows with its lag, (n,).

        x : as measured; before : (1,) of the sample before
        """
        most = self._config.upstream_lag_most_phi
        rise = np.nan_to_num(np.diff(x, prepend=before)) / self._period_s
        return np.minimum(x + np.clip(self._config.upstream_lag_s * rise, -most, most), 1.0)

    def _held(self, own: FloatArray, good: BoolArray) -> tuple[FloatArray, BoolArray]:
        """Return the values with short gaps bridged, (n, 3), and where they can be used, (n,)."""
        n = len(own)
        padded = np.vstack([self._last, own])
        rows = np.where(np.isfinite(padded), np.arange(n + 1)[:, np.newaxis], 0)
        np.maximum.accumulate(rows, axis=0, out=rows)
        held = np.take_along_axis(padded, rows, axis=0)[1:]
        self._last = held[-1].copy()
        complete = good.all(axis=1)
        ticks = np.arange(n)
        since = np.maximum.accumulate(np.where(complete, ticks, -1))
        missing = np.where(since < 0, self._missing + ticks + 1, ticks - since)
        self._missing = int(missing[-1])
        return held, np.isfinite(held).all(axis=1) & (missing <= self._n_hold)

    def _warm(self, values: FloatArray, run: IntArray) -> BoolArray:
        """Return on which samples the brick is warm, by its temperature or by running time."""
        long = np.asarray(run >= self._n_warm_up)
        if self._brick is None:
            return long
        degc = values[:, self._brick]
        return np.where(np.isfinite(degc), degc >= self._config.warm_degc, long)

    @property
    def supported(self) -> tuple[str, ...]:
        """Return the tests behind the catalyst that the signals so far allow."""
        if not self.is_heard:
            return ()
        circuit = () if self._is_wide else (CIRCUIT,)
        heater = (HEATER,) if self.circuit.can_judge_heater else ()
        return ("catalyst", "downstream", "balance", *circuit, *heater)

    def entry(self) -> dict[str, Any] | None:
        """Return the report's entry of the catalyst, None without a downstream sensor."""
        if self.rule is None:
            return None
        rule, capacity = self.rule, self.rule.capacity()
        catalyst, sensor, balance = rule.catalyst(), rule.sensor(), rule.balance()
        found: dict[str, Any] = {
            "segments": rule.segments,
            "threshold_g": self._config.threshold_g,
            "capacity_g": None,
            "capacity_low_g": None,
            "capacity_high_g": None,
            "capacity_is_bound": False,
            "verdict": catalyst.outcome,
            "log_odds": round(catalyst.log_odds, 3),
            "sensor_verdict": sensor.outcome,
            "sensor_log_odds": round(sensor.log_odds, 3),
            "balance_verdict": balance.outcome,
            "balance_log_odds": round(balance.log_odds, 3),
            "upstream_offset_lambda": round(-rule.offset(), 5),
            "upstream_offset_std": round(rule.offset_std(), 5),
            "needed": round(rule.evidence_fail, 3),
        }
        if capacity is not None:
            found |= {
                "capacity_g": round(capacity.grams, 4),
                "capacity_low_g": round(capacity.low_g, 4),
                "capacity_high_g": None if capacity.is_bound else round(capacity.high_g, 4),
                "capacity_is_bound": capacity.is_bound,
            }
        return found


def _x_of(lambda_upstream: FloatArray) -> FloatArray:
    """Return 1 - 1/lambda."""
    return np.asarray(1.0 - 1.0 / np.maximum(lambda_upstream, 0.1))
