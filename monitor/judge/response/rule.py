"""The response rule: which sensor, run on the prediction, reads like the real one?

Every claim says how a sensor follows the mixture: one column of the bank of ``hypotheses`` (a lag
or a dead time on one edge direction or both) and a range for its gain. Evidence for each claim is
summed over windows until one fault, or the sound sensor, leads by enough. Every window counts by
how well its prediction separates the claims: one in which the mixture hardly moves, or which the
model follows badly, adds little, and none is left out for it.

Sources: Basseville and Nikiforov, Detection of Abrupt Changes, chapter 4 (log likelihood ratios
summed until a threshold); Wald, Sequential Analysis, section 3.2 (the thresholds for stated
probabilities of a false alarm and of a miss); Kay, Fundamentals of Statistical Signal Processing
II, section 9.3 (linear model in coloured noise: whiten both sides); Lange, Little and Taylor,
Robust statistical modeling using the t distribution, JASA 84 (1989) (a scale of its own for each
window, and the weights that follow from it).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from monitor.base.config import ResponseConfig
from monitor.base.types import BoolArray, FloatArray
from monitor.judge.residual import means_and_stds, whitened
from monitor.judge.response.bank import Hypothesis
from monitor.judge.response.claims import UNRELATED, Noise, claims
from monitor.judge.response.estimates import Estimates

Outcome = Literal["passed", "failed", "inconclusive"]
EDGES = ("rich_to_lean", "lean_to_rich")
_WINDOWS = 8  # regressed at once: what fits into the processor's cache


@dataclass(frozen=True, slots=True)
class Response:
    """The finding of the response rule after a window."""

    outcome: Outcome
    fault: str | None
    also: tuple[str, ...]
    column: int  # of the bank: what the likeliest sensor reads
    statistics: Estimates


class ResponseRule:
    """Sequential comparison of claims, constant memory.

    In each window measurement and bank are whitened by the healthy residual's memory, and the
    offset is taken off. Each claim has one gain, within its range, estimated over the drive by
    least squares with the windows weighted by the inverse of their error's variance, and fading by
    ``gain_memory`` per window. The log likelihood of a window, whose scale is unknown and at least
    ``noise_least`` of the healthy innovation's variance, is added to the claim's evidence;
    ``evidence_weight`` of its samples count as independent.

    noise : of the healthy residual
    evidence_weight : at most that of the settings; lower for a model whose errors look like faults
    window_most : no claim falls further behind the best one in one window; for a model that
        predicts steps early or late, which then look like a delay. Where no window may decide, the
        timing is unsure, and a sensor is called sound only if it were so ``timing_s`` slower, too
    gain_reference : this vehicle's healthy gain, which the gains of the claims are relative to
    """

    def __init__(
        self,
        config: ResponseConfig,
        bank: tuple[Hypothesis, ...],
        noise: Noise,
        period_s: float,
        evidence_weight: float = 1.0,
        gain_reference: float = 1.0,
        window_most: float = math.inf,
    ) -> None:
        self._config, self._noise = config, noise
        self._weight = min(evidence_weight, config.evidence_weight)
        self._least_var = config.noise_least * noise.innovation_var
        self._window_most = window_most
        self._claims, self._n_columns = claims(config, bank), len(bank)
        self._columns = np.array([c.column for c in self._claims])
        self._gain_reference = gain_reference
        self._gain_low = np.array([c.gain_low for c in self._claims])
        self._gain_high = np.array([c.gain_high for c in self._claims])
        names = np.array([c.fault for c in self._claims])
        self._sound = np.flatnonzero(names == "")
        errs = window_most < config.evidence_fail  # the model errs more than its noise
        near = np.array([errs and c.hypothesis.near_limit for c in self._claims])
        self._surely = np.flatnonzero((names == "") & ~near)
        self._barely = np.flatnonzero((names == "") & near)
        self._faults = np.flatnonzero((names != "") & (names != UNRELATED))
        times = np.array([_times(c.hypothesis) for c in self._claims]).T
        self._moments = np.vstack((times, times**2))
        self._lead = config.lead_s / period_s
        self._ahead = math.ceil(self._lead)
        n = len(self._claims)
        self._evidence: FloatArray = np.zeros(n)
        # weighted sums of prediction squared, and of measurement times prediction, per claim
        self._gain_sums: FloatArray = np.zeros((2, n))
        self.reset()

    def reset(self) -> None:
        """Forget all evidence."""
        n, known = len(self._claims), self._config.gain_known
        self._evidence.fill(0.0)
        self._gain_sums.fill(known)
        self._drive_sums = np.zeros((3, n))  # like gain sums and evidence, but nothing fades
        self.windows = 0  # that were not ignored

    @property
    def odds(self) -> dict[str, float]:
        """Return for each fault its log likelihood over all that is no fault, over all windows.

        Against a fault, a sound sensor that is near its limit counts as the fault.
        """
        evidence = self._evidence
        other = max(evidence[self._sound].max(), evidence[-1])
        leads: dict[str, float] = {}
        for i in self._faults.tolist():
            name = self._claims[i].fault
            leads[name] = max(leads.get(name, -math.inf), float(evidence[i] - other))
        surely = max(evidence[self._surely].max(), evidence[-1])
        for i in self._barely.tolist():
            name = self._claims[i].hypothesis.fault
            if leads[name] < 0.0:
                leads[name] = max(leads[name], min(float(evidence[i] - surely), 0.0))
        return leads

    @property
    def drive_gain(self) -> float:
        """Return the gain of the likeliest sound sensor over all judged windows; 1 without one."""
        sound = self._sound[self._drive_sums[2, self._sound].argmax()]
        sxx, sxy, _ = self._drive_sums[:, sound].tolist()
        return self._gain_reference * sxy / sxx if sxx > 0.0 else 1.0

    def judge(
        self, measured: FloatArray, banks: Sequence[FloatArray], ignore: BoolArray
    ) -> list[Response]:
        """Return the verdicts after windows that follow each other; ignored ones are inconclusive.

        measured : (w, n) phi, or the output oriented like it
        banks : w of (n, n_hypotheses) what each hypothesis reads, column 0 the prediction itself
        ignore : (w,)
        """
        _, excitation = means_and_stds(np.array([bank[:, 0] for bank in banks]))
        usable = ~ignore
        moments = self._regressed(measured, banks, usable)
        summed = self._summed(usable, moments, measured.shape[1] - self._ahead - 1)
        return self._reports(usable, excitation, *summed)

    def _regressed(
        self, measured: FloatArray, banks: Sequence[FloatArray], usable: BoolArray
    ) -> FloatArray:
        """Return sxx, sxy and syy of each claim in usable windows, means, (w, 3, n_claims)."""
        places = np.flatnonzero(usable)
        moments = np.empty((len(places), 3, len(self._claims)))
        for first in range(0, len(places), _WINDOWS):
            chosen = places[first : first + _WINDOWS]
            part = [banks[i] for i in chosen.tolist()]
            moments[first : first + _WINDOWS] = self._regressed_some(measured[chosen], part)
        return moments

    def _regressed_some(self, measured: FloatArray, banks: Sequence[FloatArray]) -> FloatArray:
        n = measured.shape[1]
        m = n - self._ahead
        x = np.empty((len(banks), m, self._n_columns + 1))
        for each, bank in zip(x, banks, strict=True):
            each[:, :-1] = bank[:m]
            each[:, -1] = self._quicker(bank[:, 0], m)
        y = whitened(measured[:, :m], self._noise.memory)
        x = whitened(x, self._noise.memory)
        moments = np.empty((len(banks), 3, len(self._claims)))
        np.einsum("wij,wij->wj", x, x).take(self._columns, 1, moments[:, 0], "clip")
        (y[:, np.newaxis] @ x)[:, 0].take(self._columns, 1, moments[:, 1], "clip")
        moments[:, 2] = (y[:, np.newaxis] @ y[:, :, np.newaxis])[:, 0]
        moments /= y.shape[1]
        moments[:, 0] *= self._gain_reference**2
        moments[:, 1] *= self._gain_reference
        return moments

    def _summed(
        self, usable: BoolArray, moments: FloatArray, n_new: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return evidence, (w, n_claims), and gain sums, (w, 2, n_claims), after each window.

        n_new : whitened samples of a window
        """
        evidence = np.empty((len(usable), len(self._claims)))
        gain_sums = np.empty((len(usable), 2, len(self._claims)))
        rest = iter(moments)
        for now, sums, is_usable in zip(evidence, gain_sums, usable.tolist(), strict=True):
            if is_usable:
                self._add(next(rest), n_new)
            now[:], sums[:] = self._evidence, self._gain_sums
        return evidence, gain_sums

    def _add(self, moments: FloatArray, n_new: int) -> None:
        """Add a window's moments, (3, n_claims), to gains and evidence."""
        sums, evidence = self._gain_sums, self._evidence
        weighted = moments[:2] * (n_new / self._error_var(moments, self._gain(sums)))
        sums *= self._config.gain_memory
        sums += weighted
        error_var = self._error_var(moments, self._gain(sums))
        log_likelihood = -0.5 * self._weight * n_new * np.log(error_var)
        np.maximum(log_likelihood, log_likelihood.max() - self._window_most, out=log_likelihood)
        log_likelihood -= log_likelihood[0]
        evidence += log_likelihood
        # a long healthy time must not outweigh the fault that follows it (Page's test)
        np.maximum(evidence, evidence.max() - self._config.evidence_most, out=evidence)
        self._drive_sums[:2] += weighted
        self._drive_sums[2] += log_likelihood

    def _gain(self, sums: FloatArray) -> FloatArray:
        """Return each claim's gain over the reference, within its range, from all windows."""
        gain: FloatArray = sums[1] / sums[0]
        np.maximum(gain, self._gain_low, out=gain)
        np.minimum(gain, self._gain_high, out=gain)
        return gain

    def _error_var(self, moments: FloatArray, gain: FloatArray) -> FloatArray:
        """Return the variance of each claim's error in a window, its least part added."""
        sxx, sxy, syy = moments
        error_var: FloatArray = np.maximum(syy - gain * (2.0 * sxy - gain * sxx), 0.0)
        error_var += self._least_var
        return error_var

    def _quicker(self, now: FloatArray, m: int) -> FloatArray:
        """Return the prediction ``lead_s`` ahead of its time, (m,)."""
        part = self._ahead - self._lead
        if self._ahead == 0:
            return now
        return (1.0 - part) * now[self._ahead :] + part * now[self._ahead - 1 : -1]

    def _reports(
        self,
        usable: BoolArray,
        excitation: FloatArray,
        evidence: FloatArray,
        gain_sums: FloatArray,
    ) -> list[Response]:
        faulty = evidence.take(self._faults, 1)
        fault = faulty.argmax(axis=1)
        likeliest_fault = faulty.max(axis=1)
        surely = evidence.take(self._surely, 1).max(axis=1)
        barely = evidence.take(self._barely, 1).max(axis=1, initial=-np.inf)
        sound = np.maximum(surely, barely)
        unrelated = evidence[:, -1]
        margin = likeliest_fault - np.maximum(sound, unrelated)
        lead = surely - np.maximum(np.maximum(likeliest_fault, barely), unrelated)
        best = evidence.argmax(axis=1)
        times = self._estimated_times(evidence)
        found = []
        columns = usable.tolist(), margin.tolist(), lead.tolist(), best.tolist()
        for i, is_usable, gap, sound_gap, own in zip(range(len(evidence)), *columns, strict=True):
            self.windows += is_usable
            outcome: Outcome = "inconclusive"
            name: str | None = None
            also: tuple[str, ...] = ()
            likeliest = int(self._faults[fault[i]])
            if is_usable and gap >= self._config.evidence_fail:
                outcome, name = "failed", self._claims[likeliest].fault
                also = self._alike(evidence[i], likeliest)
            elif is_usable and sound_gap >= self._config.evidence_pass:
                outcome = "passed"
            claim = self._claims[own]
            gain = self._estimated_gain(gain_sums[i, :, own].tolist())
            hypothesis = claim.fault or "healthy"
            statistics = Estimates._make((float(excitation[i]), gap, hypothesis, *times[i], *gain))
            column = claim.column if claim.column < self._n_columns else 0
            found.append(Response(outcome, name, also, column, statistics))
        return found

    def _alike(self, evidence: FloatArray, best: int) -> tuple[str, ...]:
        behind = evidence[best] - evidence[self._faults]
        close = self._faults[behind < self._config.evidence_alike].tolist()
        return tuple(sorted({self._claims[i].fault for i in close} - {self._claims[best].fault}))

    def _estimated_times(self, evidence: FloatArray) -> list[list[float]]:
        """Return lags and dead times, each with its standard deviation, after each window.

        They are means over the claims, weighted by their likelihood (all alike beforehand).
        """
        weight = np.exp(evidence - evidence.max(axis=1)[:, np.newaxis])
        weight /= np.add.reduce(weight, axis=1)[:, np.newaxis]
        found = (self._moments @ weight[:, :, np.newaxis]).reshape(len(evidence), 2, len(_TIMES))
        mean, square = found[:, 0], found[:, 1]
        np.sqrt(np.maximum(square - mean**2, 0.0), out=square)
        rows: list[list[float]] = found.swapaxes(1, 2).reshape(len(evidence), -1).tolist()
        return rows

    def _estimated_gain(self, sums: Sequence[float]) -> tuple[float | None, float | None]:
        """Return the gain with its standard deviation; None before any window."""
        if not self.windows:
            return None, None
        sxx, sxy = sums
        reference = self._gain_reference
        std = reference * math.sqrt(1.0 / (self._weight * sxx))
        return reference * sxy / sxx, std


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
