"""Tests that need no model: the signal is missing, implausible, not ready or frozen.

``step`` and ``push`` take one sample, ``block`` a whole recording; a property test holds them
together.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.base.config import PlausibilityConfig
from monitor.base.runs import since, stretches
from monitor.base.types import BoolArray, FloatArray, IntArray, Quality, QualityArray, Sample
from monitor.model.card import Channel

_ENGINE = ("engine_speed_rpm", "sensor_ready")  # tell whether the sensor can be heated
_GOOD, _STALE, _INVALID, _OUT_OF_RANGE, _OFF_BUS = (int(quality) for quality in Quality)


@dataclass(frozen=True, slots=True)
class TickResult:
    """One result of one test on one sample."""

    test: str  # "communication", "range" or "ready"
    failed: bool
    fault: str


_HEARD = TickResult("communication", False, "signal_missing")
_MISSING = TickResult("communication", True, "signal_missing")
_NOT_VALID = TickResult("communication", True, "signal_invalid")
_BUS_OFF = TickResult("communication", True, "bus_off")
_READY, _NOT_READY = (TickResult("ready", failed, "not_ready") for failed in (False, True))
_INSIDE, _OUTSIDE = (TickResult("range", failed, "out_of_range") for failed in (False, True))


class TickResults(NamedTuple):
    """All results of one test on a recording."""

    at: IntArray  # (m,) numbers of the samples that allow a result, ascending
    kind: IntArray  # (m,) place in ``kinds``
    kinds: tuple[TickResult, ...]
    failed: BoolArray  # (m,)


class Plausibility:
    """Judges the quality of the measured signal, sample by sample.

    names : what a sample holds
    output : name of the measured signal among them
    """

    def __init__(
        self, config: PlausibilityConfig, names: Sequence[str], output: str, period_s: float
    ) -> None:
        at = {name: i for i, name in enumerate(names)}
        self._output = at[output]
        self._ready = at.get("sensor_ready")
        self._speed = at.get("engine_speed_rpm")
        self._running_rpm = config.engine_running_rpm
        self._patience = round(config.not_ready_s / period_s)
        self._start_patience = round(config.start_patience_s / period_s)
        self.reset()

    def reset(self) -> None:
        """Start as after switching on."""
        self._not_ready = 0  # samples in a row with the engine running
        self._unheard = 0  # samples before the sender was heard for the first time
        self._heard = False
        self._stood = False  # the engine stood when its speed was last known

    def step(self, sample: Sample) -> list[TickResult]:
        """Return the results this sample allows."""
        quality = sample.quality.item(self._output)
        ready = self._is_ready(sample, quality)
        gone = self._ready is not None and math.isnan(sample.values.item(self._ready))
        waiting = not ready and not gone and self.is_running(sample)
        self._not_ready = self._not_ready + 1 if waiting else 0
        # a blank in a table reads as invalid; with the readiness blank, too, nothing came
        missing = quality in (_STALE, _OFF_BUS) or (quality == _INVALID and gone)
        invalid = quality == _INVALID and ready
        self._heard = self._heard or not missing
        self._unheard += not self._heard
        if self._speed is not None and not math.isnan(rpm := sample.values.item(self._speed)):
            self._stood = rpm < self._running_rpm
        # with the ignition off an ECU falls silent, which is no fault
        asleep = missing and self._stood and quality != _OFF_BUS
        results = []
        if (self._heard or self._unheard > self._start_patience) and not asleep:
            if quality == _OFF_BUS:
                results.append(_BUS_OFF)
            elif invalid:
                results.append(_NOT_VALID)
            else:
                results.append(_MISSING if missing else _HEARD)
        if self._not_ready > self._patience or (ready and not missing):  # else not known yet
            results.append(_READY if ready else _NOT_READY)
        if quality in (_GOOD, _OUT_OF_RANGE):
            results.append(_INSIDE if quality == _GOOD else _OUTSIDE)
        return results

    def block(self, values: FloatArray, quality: QualityArray) -> tuple[TickResults, ...]:
        """Return the results of a recording from switching on, those of ``step`` in its order.

        values, quality : (n, n_names)
        """
        n, q = len(values), quality[:, self._output]
        told = np.full(n, np.nan) if self._ready is None else values[:, self._ready]
        ready = np.where(np.isnan(told), q != _INVALID, told > 0.0)
        gone = np.zeros(n, dtype=np.bool_) if self._ready is None else np.isnan(told)
        not_ready = since(~(~ready & ~gone & self.running(values)))
        off_bus = q == _OFF_BUS
        missing = (q == _STALE) | off_bus | ((q == _INVALID) & gone)
        invalid = (q == _INVALID) & ready
        asleep = missing & self._standing(values) & ~off_bus
        unheard = np.cumsum(np.minimum.accumulate(missing))
        heard = ~np.minimum.accumulate(missing)
        return (
            _results(
                (heard | (unheard > self._start_patience)) & ~asleep,
                np.where(off_bus, 3, np.where(invalid, 2, missing)),
                _HEARD,
                _MISSING,
                _NOT_VALID,
                _BUS_OFF,
            ),
            _results(
                (not_ready > self._patience) | (ready & ~missing),
                ~ready,
                _READY,
                _NOT_READY,
            ),
            _results(
                (q == _GOOD) | (q == _OUT_OF_RANGE),
                q == _OUT_OF_RANGE,
                _INSIDE,
                _OUTSIDE,
            ),
        )

    def _is_ready(self, sample: Sample, quality: int) -> bool:
        ready = math.nan if self._ready is None else sample.values.item(self._ready)
        return quality != _INVALID if math.isnan(ready) else ready > 0.0

    def is_running(self, sample: Sample) -> bool:
        """Return whether the engine runs; without its speed it does."""
        return self._speed is None or sample.values.item(self._speed) >= self._running_rpm

    def running(self, values: FloatArray) -> BoolArray:
        """Return ``is_running`` of a recording, (n,)."""
        if self._speed is None:
            return np.ones(len(values), dtype=np.bool_)
        return np.asarray(values[:, self._speed] >= self._running_rpm)

    def _standing(self, values: FloatArray) -> BoolArray:
        """Return whether the engine stood when its speed was last known, (n,)."""
        n = len(values)
        if self._speed is None:
            return np.zeros(n, dtype=np.bool_)
        speed_rpm = values[:, self._speed]
        known = np.maximum.accumulate(np.where(np.isnan(speed_rpm), -1, np.arange(n)))
        return np.asarray((known >= 0) & (speed_rpm[known] < self._running_rpm))


def _results(allowed: BoolArray, kind: np.ndarray, *kinds: TickResult) -> TickResults:
    at = np.flatnonzero(allowed)
    kind = kind[at].astype(np.int64)
    failed = np.array([each.failed for each in kinds])
    return TickResults(at, kind, kinds, failed[kind])


class ActivityTest:
    """Finds a frozen signal: no change over so many samples though the engine burns fuel.

    saturated : highest output that training saw; there, in fuel cut, a sensor may stand still
    cold : reading of a healthy sensor that is not heated yet, if it may be read unknowingly
    """

    def __init__(
        self,
        config: PlausibilityConfig,
        saturated: float,
        period_s: float,
        cold: float = -math.inf,
    ) -> None:
        self._config = config
        self._saturated, self._cold = saturated, cold
        self._n = max(round(config.stuck_s / period_s), 2)
        self.reset()

    @classmethod
    def of(
        cls, config: PlausibilityConfig, output: Channel, names: Sequence[str], period_s: float
    ) -> "ActivityTest":
        """Return the test of a model's output on samples of ``names``.

        Where nothing says whether the engine runs, a healthy sensor may stand still at its lowest
        reading, heater and engine off, if it dwelt there in training.
        """
        dwelt = output.percentile_0_1 - output.minimum <= config.stuck_range
        cold = output.minimum if dwelt and not set(_ENGINE) & set(names) else -math.inf
        return cls(config, output.maximum, period_s, cold)

    def reset(self) -> None:
        """Begin anew."""
        self._count = 0
        self._low = self._high = 0.0

    def push(self, measured: float) -> tuple[bool, str] | None:
        """Take one sample; return (failed, fault) when the stretch is judged."""
        if self._count == 0:
            self._low = self._high = measured
        self._low, self._high = min(self._low, measured), max(self._high, measured)
        self._count += 1
        if self._count < self._n:
            return None
        self._count = 0
        return self._judged(self._low, self._high, measured)

    def block(self, measured: FloatArray, active: BoolArray) -> list[tuple[int, bool, str]]:
        """Return (sample, failed, fault) of every stretch of a recording that is judged.

        active : (n,) whether ``push`` would take the sample; any other is a ``reset``
        """
        begin = stretches(active, self._n)
        parts = measured[begin[:, np.newaxis] + np.arange(self._n)]
        ends, low, high = begin + self._n - 1, parts.min(axis=1), parts.max(axis=1)
        found = []
        for i, *part in zip(
            ends.tolist(), low.tolist(), high.tolist(), measured[ends].tolist(), strict=True
        ):
            judged = self._judged(*part)
            if judged is not None:
                found.append((i, *judged))
        return found

    def _judged(self, low: float, high: float, last: float) -> tuple[bool, str] | None:
        frozen = high - low <= self._config.stuck_range
        at_rest = last >= self._saturated or last <= self._cold + self._config.stuck_range
        if frozen and at_rest:
            return None
        return frozen, self._name(last)

    def _name(self, measured: float) -> str:
        if abs(measured - 1.0) <= self._config.stuck_band_at_one:
            return "stuck_at_one"
        return "stuck_lean" if measured > 1.0 else "stuck_rich"
