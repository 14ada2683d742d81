"""The catalyst's rule: which catalyst, sensor and offset explain the downstream voltage?

Each member of the bank predicts the voltage. The log likelihood of the measured voltage, in a
distribution with heavy tails, is summed over segments of a few seconds. No segment counts for more
than ``segment_most`` against any member, so one oddity decides nothing. A long drive counts as
``evidence_segments``, the latest most: errors of the model repeat in every segment, and would win
by the length of a drive alone.
Claims are compared by the sequential test of the response rule: a claim holds when it leads by the
log odds of the stated probabilities of a false alarm and of a miss (Wald, Sequential Analysis,
section 3.2).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.config import Config, ResponseConfig
from monitor.base.types import FloatArray
from monitor.judge.catalyst.bank import LEAK, MID_V, STUCK, WEAK, CatalystBank
from monitor.judge.catalyst.estimate import Capacity, CapacityCurve, jackknife
from monitor.judge.window import Opinion

CATALYST: Final = "catalyst_low"
SMALLEST: Final = 1e-300  # likelihood relative to the likeliest, so that it has a logarithm
PRODUCT: Final = 50  # samples whose likelihoods are multiplied before a logarithm is taken
IMPOSSIBLE: Final = -1e9  # log likelihood of a member that the voltage rules out


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim(Opinion):
    """How the evidence stands for one test."""

    log_odds: float = 0.0  # of the likeliest fault over all that is none


def claim_of(
    log_odds: float, fault: str, config: ResponseConfig, also: tuple[str, ...] = ()
) -> Claim:
    """Return how the evidence stands for a fault, by its log odds."""
    if log_odds >= config.evidence_fail:
        return Claim("failed", fault, also, log_odds=log_odds)
    is_sound = -log_odds >= config.evidence_pass
    return Claim("passed" if is_sound else "inconclusive", log_odds=log_odds)


class CatalystRule:
    """Sequential comparison of the bank's members, constant memory.

    wide : the downstream sensor is one of wide range
    """

    def __init__(self, settings: Config, period_s: float, *, wide: bool = False) -> None:
        self._config, self._odds = settings.catalyst, settings.response
        config = self._config
        bank = self._bank = CatalystBank(config, period_s, wide=wide)
        self._n_segment = max(round(config.segment_s / period_s), 1)
        self._weight = period_s / config.memory_s
        capacity = bank.capacity_g[:, 0]
        self._curve = CapacityCurve(np.log(capacity))
        margin = config.threshold_margin
        self._is_low = capacity < config.threshold_g / margin
        self._is_sound = capacity > config.threshold_g * margin
        self._faults = [s.fault for s in bank.sensors]
        self._stuck = [i for i, fault in enumerate(self._faults) if fault in STUCK]
        prior = -0.5 * (bank.offset / config.offset_std_phi) ** 2
        bad = np.array([config.sensor_prior if f else 0.0 for f in self._faults])
        self._has_leak = np.array([fault == LEAK for fault in self._faults])
        self._prior = prior - bad[:, np.newaxis, np.newaxis]
        self._evidence = np.zeros(self._bank.shape)
        self._parts = np.zeros((self._config.offset_parts, *self._bank.shape))
        self.segments = 0
        self.low_v, self.high_v = math.inf, -math.inf  # of the voltage that was judged
        self._sum_v, self._n_v = 0.0, 0
        self.interrupt()

    def interrupt(self) -> None:
        """Lose track of the filling, after samples that are missing."""
        self._bank.reset()
        self._begin()

    def _begin(self) -> None:
        self._segment, self._product = np.zeros(self._bank.shape), np.ones(self._bank.shape)
        self._least, self._most = math.inf, -math.inf  # of the measured voltage
        self._least_of = np.full(self._bank.shape, math.inf)  # of each member's
        self._most_of = np.full(self._bank.shape, -math.inf)
        self._n = 0

    def push(self, x: float, air_g_s: float, volts: float, *, counts: bool) -> bool:
        """Take the next sample; return whether a segment ends with it.

        x : 1 - 1/lambda upstream; counts : whether the sample may be judged
        """
        predicted = self._bank.step(x, air_g_s)
        if counts:
            self._add(predicted, volts)
        is_full = counts and self._n == self._n_segment
        if is_full:
            self._close()
        return is_full

    def _add(self, predicted: FloatArray, volts: float) -> None:
        self.low_v, self.high_v = min(self.low_v, volts), max(self.high_v, volts)
        self._sum_v += volts
        self._n_v += 1
        predicted[self._stuck] = self._sum_v / self._n_v  # such a sensor reads its own mean
        self._least, self._most = min(self._least, volts), max(self._most, volts)
        np.minimum(self._least_of, predicted, out=self._least_of)
        np.maximum(self._most_of, predicted, out=self._most_of)
        predicted -= volts
        predicted *= predicted
        predicted *= 1.0 / (self._config.tail * self._config.voltage_std_v**2)
        predicted += 1.0
        self._product *= predicted
        self._n += 1
        if self._n % PRODUCT == 0:
            self._add_product()

    def _add_product(self) -> None:
        """Add the log likelihood of the samples since the last call to the segment's."""
        self._segment -= 0.5 * (self._config.tail + 1.0) * np.log(self._product)
        self._product[:] = 1.0

    def _close(self) -> None:
        self._add_product()
        segment = self._fairly() * self._weight
        possible = [self._may_be(fault) for fault in self._faults]
        gained = np.clip(segment - segment[possible].max(), -self._config.segment_most, 0.0)
        if self.segments >= self._config.evidence_segments:
            keep = 1.0 - 1.0 / self._config.evidence_segments
            self._evidence *= keep
            self._parts *= keep
        self._evidence += gained
        self._parts[self.segments // self._config.offset_block % len(self._parts)] += gained
        top = self._evidence[possible].max()
        np.clip(self._evidence, top - self._config.evidence_most, top, out=self._evidence)
        self._begin()
        self.segments += 1

    def _fairly(self) -> FloatArray:
        """Return the segment's log likelihoods; those at rest count less for a wrong level.

        The level at which a voltage rests between rich and lean depends on sensor and gas, and each
        segment at rest tells it anew. So where the measured voltage and a member's both rest, only
        ``rest_weight`` of a level within ``rest_level_v`` counts.
        """
        config = self._config
        if self._most - self._least > config.rest_range_v:
            return self._segment
        rests = self._most_of - self._least_of <= config.rest_range_v
        nu, z = config.tail, config.rest_level_v / config.voltage_std_v
        within = -0.5 * (nu + 1.0) * math.log1p(z * z / nu) * self._n
        eased = self._segment - (1.0 - config.rest_weight) * np.maximum(self._segment, within)
        return np.where(rests, eased, self._segment)

    def _restricted(self, evidence: FloatArray) -> FloatArray:
        """Return evidence and prior together, without the sensors that the voltage rules out."""
        total = evidence + self._prior
        total[[not self._may_be(fault) for fault in self._faults]] = IMPOSSIBLE
        return np.asarray(total)

    def _may_be(self, fault: str) -> bool:
        """Return whether the range of the voltage so far allows a fault of its amplitude."""
        config = self._config
        if fault == WEAK:
            return min(MID_V - self.low_v, self.high_v - MID_V) < MID_V - config.lean_v
        if fault not in STUCK:
            return True
        is_lean = self._sum_v < MID_V * self._n_v
        is_still = self.high_v - self.low_v <= config.rest_range_v
        return is_still and fault == STUCK[0 if is_lean else 1]

    def catalyst(self) -> Claim:
        """Return how the evidence stands for a catalyst below the threshold."""
        total = self._restricted(self._evidence)
        low, sound = (_sum(total[:, capacity]) for capacity in (self._is_low, self._is_sound))
        return self._likeliest({CATALYST: low}, sound)

    def sensor(self) -> Claim:
        """Return how the evidence stands for a faulty downstream sensor."""
        total, faults = self._restricted(self._evidence), np.array(self._faults)
        each = {fault: _sum(total[faults == fault]) for fault in dict.fromkeys(self._faults)}
        sound = np.logaddexp(each.pop(""), each.pop(LEAK, -math.inf))
        return self._likeliest(each, float(sound))

    def balance(self) -> Claim:
        """Return how the evidence stands for an upstream reading against the oxygen balance.

        An upstream sensor that reads lean needs oxygen taken off; one with a leak behind it, added.
        """
        total, offset = self._restricted(self._evidence), self._bank.offset
        intact, leaking = total[~self._has_leak], total[self._has_leak]
        least = self._config.offset_biased_phi
        odds = {
            "biased_lean": _sum(intact[:, :, offset <= -least]),
            "biased_rich": _sum(intact[:, :, offset >= least]),
            LEAK: _sum(leaking),
        }
        is_sound = np.abs(offset) <= self._config.offset_sound_phi
        return self._likeliest(odds, _sum(intact[:, :, is_sound]))

    def _likeliest(self, each: dict[str, float], sound: float) -> Claim:
        """Return how the evidence stands for the likeliest fault, and which are as likely."""
        name = max(each, key=lambda fault: each[fault])
        least = each[name] - self._odds.evidence_alike
        also = tuple(fault for fault in each if fault != name and each[fault] > least)
        odds = float(each[name] - sound)
        return claim_of(odds, name, self._odds, also) if self.segments else Claim(log_odds=odds)

    def capacity(self) -> Capacity:
        """Return the estimated capacity; before any evidence it says nothing."""
        weights = [np.maximum(self._weights(1, each), SMALLEST) for each in self._evidences]
        own, *without = np.log(weights)
        return self._curve.estimate(own, np.array(without), self._config.capacity_model)

    @property
    def _evidences(self) -> list[FloatArray]:
        """Return the evidence, then that of all stretches of the drive but one, part by part."""
        whole = self._parts.sum(axis=0)
        return [self._evidence, *(whole - part for part in self._parts)]

    def _weights(self, axis: int, evidence: FloatArray) -> FloatArray:
        """Return how likely each sensor (axis 0), capacity (1) or offset (2) is; the sum is 1."""
        total = self._config.interval_weight * self._restricted(evidence)
        weight = np.exp(total - total.max()).sum(axis=tuple({0, 1, 2} - {axis}))
        return np.asarray(weight / weight.sum())

    def sensor_lags(self) -> dict[str, float]:
        """Return the expected lag and dead time of the downstream sensor in s, by edge."""
        weight, sensors = self._weights(0, self._evidence), self._bank.sensors
        to_rich = [s.tau_to_rich_s + s.delay_s * (s.direction >= 0) for s in sensors]
        to_lean = [s.tau_to_lean_s + s.delay_s * (s.direction <= 0) for s in sensors]
        return {"lean_to_rich": float(weight @ to_rich), "rich_to_lean": float(weight @ to_lean)}

    def offset(self) -> tuple[float, float]:
        """Return the addend of the balance to upstream x, and its standard error, in phi.

        The error comes from the spread: the drive's stretches are dealt into parts, and the offset
        is estimated without each part in turn (the jackknife; Efron and Tibshirani, An Introduction
        to the Bootstrap, chapter 11). To that comes the width of what the evidence allows, since
        the errors of the model repeat in every part.
        """
        own = np.array([self._weights(2, each) for each in self._evidences])
        mean, *without = own @ self._bank.offset
        width = own[0] @ (self._bank.offset - mean) ** 2
        spread = jackknife(np.array(without))
        return float(mean), math.sqrt(spread**2 + width + self._config.offset_model_phi**2)


def _sum(log_weights: FloatArray) -> float:
    return float(np.logaddexp.reduce(log_weights, axis=None))
