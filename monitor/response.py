"""The response rule: which sensor, run on the prediction, reads what the real one reads?

Every claim says how a sensor follows the mixture: one column of the bank of ``hypotheses`` (a lag
or a dead time on one edge direction or both) and a range for its gain. Evidence for each claim is
summed over windows until one fault, or the sound sensor, leads by enough.

Sources: Basseville and Nikiforov, Detection of Abrupt Changes, chapter 4 (log likelihood ratios
summed until a threshold); Wald, Sequential Analysis, section 3.2 (the thresholds for stated
probabilities of a false alarm and of a miss); Kay, Fundamentals of Statistical Signal Processing
II, section 9.3 (linear model in coloured noise: whiten both sides).
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from monitor.config import ResponseConfig
from monitor.hypotheses import Hypothesis
from monitor.types import FloatArray, IntArray

Outcome = Literal["passed", "failed", "inconclusive"]
EDGES = ("rich_to_lean", "lean_to_rich")


@dataclass(frozen=True, slots=True)
class Noise:
    """The healthy residual within windows, oriented like phi, as a first-order process."""

    std: float
    memory: float  # correlation of neighbouring samples, 0 to below 1

    @property
    def innovation_var(self) -> float:
        """Return the variance of what is new in each sample."""
        return self.std**2 * (1.0 - self.memory**2)


@dataclass(frozen=True, slots=True)
class Response:
    """What the response rule says after a window."""

    outcome: Outcome
    fault: str | None
    also: tuple[str, ...]
    column: int  # of the bank: what the likeliest sensor reads
    statistics: dict[str, float | str | None]


@dataclass(frozen=True, slots=True)
class Claim:
    """A sensor with this lag or dead time and a gain in this range."""

    column: int  # of the bank; behind its last one stands the sensor quicker than the model's
    hypothesis: Hypothesis
    gain_low: float
    gain_high: float
    fault: str  # "" is a sound sensor


def claims(config: ResponseConfig, bank: tuple[Hypothesis, ...]) -> tuple[Claim, ...]:
    """Return every claim about the sensor, the healthy one first."""
    top = config.gain_max
    found = []
    # a sensor quicker than the training vehicle's; without it a dead time of one period of a
    # steady modulation explains such a sensor better than none
    quick = Hypothesis("", "healthy", "symmetric", 0.0, False)
    for column, each in enumerate((*bank, quick)):
        if not each.beyond_limit:
            found.append(Claim(column, each, config.gain_sound_min, top, ""))
            found.append(Claim(column, each, 0.0, config.gain_weak_max, "gain_low"))
        elif each.kind == "delay":
            found.append(Claim(column, each, config.gain_late_min, top, each.fault))
        else:
            found.append(Claim(column, each, config.gain_slow_min, top, each.fault))
            if each.direction == "symmetric":
                found.append(Claim(column, each, 0.0, config.gain_transient_max, "transient"))
    return tuple(found)


class ResponseRule:
    """Sequential comparison of claims, constant memory.

    In each window measurement and bank are whitened by the healthy residual's memory; for each
    claim gain (within its range) and offset come from least squares, and the concentrated Gaussian
    log likelihood, with ``evidence_weight`` of the samples counted as independent, is added to the
    claim's evidence, which fades by ``evidence_memory`` per window.

    noise : of the healthy residual
    excitation_min : least standard deviation of the prediction that makes a window judgeable
    gain_reference : this vehicle's healthy gain, which the gains of the claims are relative to
    """

    def __init__(
        self,
        config: ResponseConfig,
        bank: tuple[Hypothesis, ...],
        noise: Noise,
        excitation_min: float,
        period_s: float,
        gain_reference: float = 1.0,
    ) -> None:
        self._config, self._noise = config, noise
        self._excitation_min = excitation_min
        alpha, beta = config.false_alarm_probability, config.miss_probability
        self.evidence_fail = math.log((1.0 - beta) / alpha)
        self.evidence_pass = math.log((1.0 - alpha) / beta)
        self._claims, self._n_columns = claims(config, bank), len(bank)
        self._columns = np.array([c.column for c in self._claims])
        self._gain_low = gain_reference * np.array([c.gain_low for c in self._claims])
        self._gain_high = gain_reference * np.array([c.gain_high for c in self._claims])
        faulty = np.array([bool(c.fault) for c in self._claims])
        self._faults, self._sound = np.flatnonzero(faulty), np.flatnonzero(~faulty)
        self._times = np.array([_times(c.hypothesis) for c in self._claims]).T
        self._lead = config.lead_s / period_s
        self._ahead = math.ceil(self._lead)
        self.reset()

    def reset(self) -> None:
        """Forget all evidence."""
        n = len(self._claims)
        self._evidence = np.zeros(n)
        self._gain_sums = np.zeros((2, n))
        self._drive_sums = np.zeros((3, n))  # like gain sums and evidence, but nothing fades
        self._windows = 0

    @property
    def drive_gain(self) -> float:
        """Return the gain of the likeliest sound sensor over all judged windows; 1 without one."""
        sound = self._sound[self._drive_sums[2, self._sound].argmax()]
        sxx, sxy, _ = self._drive_sums[:, sound].tolist()
        return sxy / sxx if sxx > 0.0 else 1.0

    def judge(self, measured: FloatArray, bank: FloatArray, *, ignore: bool = False) -> Response:
        """Return the verdict after one more window; an ignored one is inconclusive.

        measured : (n,) phi, or the output oriented like it
        bank : (n, n_hypotheses) what each hypothesis reads, column 0 the prediction itself
        """
        n, config = len(measured), self._config
        now = bank[:, 0]
        excitation = float(now.std())
        if ignore or excitation < self._excitation_min:
            return self._report("inconclusive", None, (), excitation)
        m = n - self._ahead
        x = np.empty((m, bank.shape[1] + 1))
        x[:, :-1] = bank[:m]
        x[:, -1] = self._quicker(now, m)
        y = self._whitened(measured[:m])
        x = self._whitened(x)
        columns = self._columns
        sxx = np.einsum("ij,ij->j", x, x)[columns]
        sxy = (y @ x)[columns]
        gain = sxy / np.maximum(sxx, 1e-12)
        np.minimum(np.maximum(gain, self._gain_low, out=gain), self._gain_high, out=gain)
        error_var = np.maximum(y @ y - gain * (2.0 * sxy - gain * sxx), 0.0) / len(y)
        independent = config.evidence_weight * len(y)
        log_likelihood = -0.5 * independent * np.log(error_var + self._noise.innovation_var)
        memory = config.evidence_memory
        log_likelihood -= log_likelihood[0]
        self._evidence *= memory
        self._evidence += log_likelihood
        # a long healthy time must not outweigh the fault that follows it (Page's test)
        least = self._evidence.max() - config.evidence_most
        np.maximum(self._evidence, least, out=self._evidence)
        self._gain_sums *= memory
        self._gain_sums[0] += sxx
        self._gain_sums[1] += sxy
        self._drive_sums += (sxx, sxy, log_likelihood)
        self._windows += 1
        return self._decide(excitation)

    def _quicker(self, now: FloatArray, m: int) -> FloatArray:
        """Return the prediction ``lead_s`` ahead of its time, (m,)."""
        part = self._ahead - self._lead
        if self._ahead == 0:
            return now
        return (1.0 - part) * now[self._ahead :] + part * now[self._ahead - 1 : -1]

    def _whitened(self, x: FloatArray) -> FloatArray:
        """Return what is new in each sample, its mean taken off."""
        new = x[1:] - self._noise.memory * x[:-1]
        new -= np.add.reduce(new) / len(new)
        return new

    def _decide(self, excitation: float) -> Response:
        evidence = self._evidence
        fault, sound = self._best_of(self._faults), self._best_of(self._sound)
        margin = float(evidence[fault] - evidence[sound])
        if margin >= self.evidence_fail:
            name = self._claims[fault].fault
            return self._report("failed", name, self._alike(fault), excitation)
        outcome: Outcome = "passed" if margin <= -self.evidence_pass else "inconclusive"
        return self._report(outcome, None, (), excitation)

    def _best_of(self, places: IntArray) -> int:
        return int(places[self._evidence[places].argmax()])

    def _alike(self, best: int) -> tuple[str, ...]:
        behind = self._evidence[best] - self._evidence[self._faults]
        close = self._faults[behind < self._config.evidence_alike].tolist()
        return tuple(sorted({self._claims[i].fault for i in close} - {self._claims[best].fault}))

    def _report(
        self, outcome: Outcome, fault: str | None, also: tuple[str, ...], excitation: float
    ) -> Response:
        best = int(self._evidence.argmax())
        claim = self._claims[best]
        margin = self._evidence[self._faults].max() - self._evidence[self._sound].max()
        statistics: dict[str, float | str | None] = {
            "excitation": excitation,
            "evidence": float(margin),
            "hypothesis": claim.fault or "healthy",
        }
        column = claim.column if claim.column < self._n_columns else 0
        return Response(outcome, fault, also, column, statistics | self._estimates(best))

    def _estimates(self, best: int) -> dict[str, float | str | None]:
        """Return lag, dead time and gain with their standard deviations.

        Times are means over the claims, weighted by their likelihood (all alike beforehand).
        """
        weight = np.exp(self._evidence - self._evidence[best])
        weight /= np.add.reduce(weight)
        mean = self._times @ weight
        std = np.sqrt(np.maximum(self._times**2 @ weight - mean**2, 0.0))
        found: dict[str, float | str | None] = {}
        for i, name in enumerate(_TIMES):
            found[f"{name}_s"], found[f"{name}_std_s"] = mean.item(i), std.item(i)
        sxx, sxy = self._gain_sums[:, best].tolist()
        seen = self._windows > 0
        found["gain"] = sxy / max(sxx, 1e-12) if seen else None
        spread = self._noise.innovation_var / self._config.evidence_weight / max(sxx, 1e-12)
        found["gain_std"] = math.sqrt(spread) if seen else None
        return found


_TIMES = tuple(f"{what}_{edge}" for what in ("lag", "dead_time") for edge in EDGES)


def _times(hypothesis: Hypothesis) -> list[float]:
    """Return lags and dead times of both edge directions, s, in the order of ``_TIMES``."""
    return [
        hypothesis.seconds
        if hypothesis.kind == kind and hypothesis.direction in (edge, "symmetric")
        else 0.0
        for kind in ("slow", "delay")
        for edge in EDGES
    ]
