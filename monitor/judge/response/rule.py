"""The response rule: which sensor, run on the prediction, reads like the real one?

Every claim says how a sensor follows the mixture: one column of the bank of ``hypotheses`` (a lag
or a dead time on one edge direction or both) and a range for its gain. Edges tell the timing,
amplitudes the gain. What a window says of both adds to each claim's evidence, until one fault, or
the sound sensor, leads by enough. Every window counts by how well its prediction separates the
claims: one in which the mixture hardly moves, or which the model follows badly, adds little.

Sources: Basseville and Nikiforov, Detection of Abrupt Changes, chapter 4 (log likelihood ratios
summed until a threshold); Wald, Sequential Analysis, section 3.2 (the thresholds for stated
probabilities of a false alarm and of a miss); Kay, Fundamentals of Statistical Signal Processing
II, section 9.3 (linear model in coloured noise: whiten both sides); Lange, Little and Taylor,
Robust statistical modeling using the t distribution, JASA 84 (1989) (a scale of its own for each
window, and the weights that follow from it); Fuller, Measurement Error Models, section 1.1 (errors
of the prediction dilute a slope; they do not dilute an amplitude).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from monitor.base.config import ResponseConfig
from monitor.base.types import BoolArray, FloatArray
from monitor.judge.limits import Limits
from monitor.judge.response.bank import EDGES, claims
from monitor.judge.window import Opinion, Outcome

_WINDOWS = 8  # regressed at once: what fits into the processor's cache
GAIN_KNOWN: Final = 1e-3  # information on a regression's gain before the drive: hardly any
GAIN_FOLLOWS: Final = 0.05  # least gain of a regression: no sensor reads the mixture reversed


class Estimates(NamedTuple):
    """What the response rule estimates in a window, beside its verdict."""

    excitation: float  # standard deviation of the prediction, output's unit
    evidence: float  # log likelihood of the likeliest fault over the likeliest sound sensor
    hypothesis: str  # the likeliest, "healthy" or a fault
    lag_rich_to_lean_s: float = 0.0
    lag_rich_to_lean_std_s: float = 0.0
    lag_lean_to_rich_s: float = 0.0
    lag_lean_to_rich_std_s: float = 0.0
    dead_time_rich_to_lean_s: float = 0.0
    dead_time_rich_to_lean_std_s: float = 0.0
    dead_time_lean_to_rich_s: float = 0.0
    dead_time_lean_to_rich_std_s: float = 0.0
    gain: float | None = None  # None before any window
    gain_std: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Response(Opinion):
    """The finding of the response rule after a window."""

    column: int  # of the bank: what the likeliest sensor reads
    explained: float | None = None  # share of the reading, see ``ResponseRule``
    statistics: Estimates


class Moments(NamedTuple):
    """Windows of whitened readings: means of products, and of how many samples."""

    sxx: FloatArray  # (w, n_columns) of what each sensor of the bank reads with itself
    sxy: FloatArray  # (w, n_columns) and with the measurement
    syy: FloatArray  # (w,) of the measurement with itself
    n: FloatArray  # (w,)


class Said(NamedTuple):
    """What windows say, before it is weighted."""

    timing: FloatArray  # (w, n_claims) log likelihood
    gain: FloatArray  # (w, n_claims) log likelihood
    ratio: FloatArray  # (w, n_columns) log of the reading's variance over that of a sound sensor
    moved: FloatArray  # (w, n_columns) share of the prediction in that variance, 0 to 1
    explained: FloatArray  # (w,) share of the reading so far, by the column that explains most


class ResponseRule:
    """Sequential comparison of claims, constant memory.

    In each window measurement and bank are whitened by the healthy residual's memory, and the
    offset is taken off. Timing: each column has one gain, estimated over the drive by least squares
    with the windows weighted by the inverse of their error's variance, and fading by
    ``gain_memory`` per window. Errors of the prediction can only lower it, so only the upper end of
    a claim's range bounds it. The log likelihood has an unknown scale of at least ``noise_least``
    of the healthy innovation's variance. Gain: ``said``. No window decides alone, for a model
    predicts some step early or late, which then looks like a delay. As it may be late by
    ``timing_s``, a sensor is called sound only if it were so that much slower, too.

    limits : how the model errs; the gains of the claims are relative to its gain, and a sensor may
        be sound without the faults that the model cannot exclude
    """

    def __init__(self, config: ResponseConfig, limits: Limits, period_s: float) -> None:
        self._config, self._limits = config, limits
        self._least_var = config.noise_least * limits.innovation_var
        self.claims = claims(config)
        self._n_columns = self.claims[-1].column
        self._columns = np.array([c.column for c in self.claims])
        self._gain_low = np.array([c.gain_low for c in self.claims])
        self._gain_high = np.array([c.gain_high for c in self.claims])
        names = self._names = np.array([c.fault for c in self.claims])
        sensors = [c.hypothesis for c in self.claims]
        near = np.array([each.near_limit for each in sensors])
        self._sound = np.flatnonzero(names == "")
        self._surely = np.flatnonzero((names == "") & ~near)
        self._barely = np.flatnonzero((names == "") & near)
        self._faults = np.flatnonzero(names != "")
        # all but a sensor that is surely sound, and faults that the model cannot exclude
        is_tested = ~np.isin(names, limits.trust.untested)
        self._others = np.flatnonzero(np.where(names == "", near, is_tested))
        # lags and dead times of both edge directions, s, in the order of ``Estimates``
        edges = [(kind, edge) for kind in ("slow", "delay") for edge in EDGES]
        acts = [
            [s.kind == k and s.direction in (e, "symmetric") for k, e in edges] for s in sensors
        ]
        times = np.array(acts).T * [each.seconds for each in sensors]
        self._moments = np.vstack((times, times**2))
        self._lead = config.lead_s / period_s
        self._ahead = math.ceil(self._lead)
        self._evidence: FloatArray = np.zeros(len(self.claims))
        # weighted sums of x x, x y and y y: prediction of a column, and measurement
        self._sums: FloatArray = np.full((3, self._n_columns + 1), GAIN_KNOWN)
        # sums of ``moved``, of its square and of its product with ``ratio``, of a column
        self._amplitudes: FloatArray = np.zeros((3, self._n_columns + 1))
        self.windows = 0  # that were not ignored
        # share of the reading that the best column explains, 0 to 1; None before any window
        self.explained: float | None = None

    @property
    def odds(self) -> dict[str, float]:
        """Return for each fault its log likelihood over all that is no fault, over all windows.

        Against a fault, a sound sensor that is near its limit counts as the fault.
        """
        evidence = self._evidence
        surely, other = evidence[self._surely].max(), evidence[self._sound].max()
        faults = dict.fromkeys(self.claims[i].fault for i in self._faults.tolist())
        leads = {name: float(evidence[self._names == name].max() - other) for name in faults}
        for i in self._barely.tolist():
            name = self.claims[i].hypothesis.fault
            if leads[name] < 0.0:
                leads[name] = max(leads[name], min(float(evidence[i] - surely), 0.0))
        return leads

    @property
    def drive_gain(self) -> float:
        """Return the gain of the likeliest sound sensor; 1 without a window."""
        column = self._columns[self._sound[self._evidence[self._sound].argmax()]]
        gain, _ = self._gain(column)
        return 1.0 if gain is None else gain

    def judge(
        self, measured: FloatArray, banks: Sequence[FloatArray], ignore: BoolArray
    ) -> list[Response]:
        """Return the verdicts after windows that follow each other; ignored ones are inconclusive.

        measured : (w, n) phi, or the output oriented like it
        banks : w of (n, n_hypotheses) what each hypothesis reads, column 0 the prediction itself
        ignore : (w,)
        """
        places = np.flatnonzero(~ignore)
        said = self.said(self.regressed(measured[places], [banks[i] for i in places.tolist()]))
        shares = said.explained.tolist()
        rest = zip(self.weighted(said), said.moved, said.ratio, shares, strict=True)
        found = []
        for bank, ignored in zip(banks, ignore.tolist(), strict=True):
            if not ignored:
                self.windows += 1
                added, moved, ratio, self.explained = next(rest)
                self._evidence += added
                # a long healthy time must not outweigh the fault that follows it (Page's test)
                self._evidence -= self._evidence.max()
                np.maximum(self._evidence, -self._config.evidence_most, out=self._evidence)
                self._amplitudes *= self._config.gain_memory
                self._amplitudes += moved, moved**2, moved * ratio
            found.append(self._report(float(bank[:, 0].std()), is_usable=not ignored))
        return found

    def regressed(self, measured: FloatArray, banks: Sequence[FloatArray]) -> Moments:
        """Return the moments of windows, in which nothing is summed; arguments as for ``judge``."""
        sxx = np.empty((len(banks), self._n_columns + 1))
        sxy, syy = np.empty_like(sxx), np.empty(len(banks))
        m = measured.shape[1] - self._ahead
        for first in range(0, len(banks), _WINDOWS):
            part = slice(first, first + _WINDOWS)
            some = banks[part]
            x = np.empty((len(some), m, self._n_columns + 1))
            for each, bank in zip(x, some, strict=True):
                each[:, :-1] = bank[:m]
                each[:, -1] = self._quicker(bank[:, 0], m)
            y = whitened(measured[part, :m], self._limits.noise_memory)
            x = whitened(x, self._limits.noise_memory)
            np.einsum("wij,wij->wj", x, x, out=sxx[part])
            sxy[part] = (y[:, np.newaxis] @ x)[:, 0]
            syy[part] = np.einsum("wi,wi->w", y, y)
        n = m - 1
        return Moments(sxx / n, sxy / n, syy / n, np.full(len(banks), float(n)))

    def said(self, moments: Moments) -> Said:
        """Return what windows that follow each other say; the gains of the timing go on.

        A window's amplitude says less of a claim the further it is from the claim's gains: the
        logarithm of its square has a Laplace distribution, whose scale is the weight's inverse.
        """
        gain, new_var = self._limits.gain_expected, self._limits.innovation_var
        predicted, product = gain**2 * moments.sxx, gain * moments.sxy
        timing, explained = np.empty((len(predicted), len(self.claims))), np.empty(len(predicted))
        for k, own in enumerate(zip(predicted, product, moments.syy, moments.n, strict=True)):
            timing[k] = self._timing(*own)
            explained[k] = (self._sums[1] ** 2 / (self._sums[0] * self._sums[2])).max()
        sound = predicted + new_var
        measured = np.log(moments.syy + self._least_var)[:, np.newaxis]
        least, most = (
            np.log(gains**2 * predicted[:, self._columns] + new_var)
            for gains in (self._gain_low, self._gain_high)
        )
        beyond = np.maximum(least - measured, 0.0) + np.maximum(measured - most, 0.0)
        return Said(timing, -beyond, measured - np.log(sound), predicted / sound, explained)

    def weighted(self, said: Said) -> FloatArray:
        """Return what windows add to the claims' evidence, (w, n_claims), the best claim's 0."""
        log_likelihood = self._limits.evidence * said.timing
        log_likelihood += self._limits.evidence_gain * said.gain
        log_likelihood -= log_likelihood.max(axis=1, keepdims=True)
        return np.asarray(np.maximum(log_likelihood, -self._config.evidence_window))

    def _timing(self, sxx: FloatArray, sxy: FloatArray, syy: float, n: float) -> FloatArray:
        """Return each claim's log likelihood in a window, (n_claims,); add it to the gains."""
        part = n / self._unexplained(self._gains(), sxx, sxy, syy)
        self._sums *= self._config.gain_memory
        self._sums += part * sxx, part * sxy, part * syy
        at = self._columns
        gains = np.minimum(self._gains()[at], self._gain_high)
        return np.asarray(-0.5 * n * np.log(self._unexplained(gains, sxx[at], sxy[at], syy)))

    def _gains(self) -> FloatArray:
        return np.asarray(np.maximum(self._sums[1] / self._sums[0], GAIN_FOLLOWS))

    def _unexplained(
        self, gain: FloatArray, sxx: FloatArray, sxy: FloatArray, syy: float
    ) -> FloatArray:
        rest: FloatArray = np.maximum(syy - gain * (2.0 * sxy - gain * sxx), 0.0)
        return rest + self._least_var

    def _quicker(self, now: FloatArray, m: int) -> FloatArray:
        """Return the prediction ``lead_s`` ahead of its time, (m,)."""
        part = self._ahead - self._lead
        if self._ahead == 0:
            return now
        return (1.0 - part) * now[self._ahead :] + part * now[self._ahead - 1 : -1]

    def _report(self, excitation: float, *, is_usable: bool) -> Response:
        """Return the finding on all windows so far, the last of which may have been ignored."""
        evidence, claims = self._evidence, self.claims
        fault = int(self._faults[evidence[self._faults].argmax()])
        margin = float(evidence[fault] - evidence[self._sound].max())
        sound = evidence[self._surely].max() - evidence[self._others].max(initial=-math.inf)
        best = claims[evidence.argmax()]
        times, gain = self._estimated_times(), self._gain(best.column)
        own = Estimates._make((excitation, margin, best.fault or "healthy", *times, *gain))
        outcome: Outcome = "inconclusive"
        name, also = None, tuple[str, ...]()
        if is_usable and margin >= self._config.evidence_fail:
            outcome, name, also = "failed", claims[fault].fault, self._alike(fault)
        elif is_usable and sound >= self._config.evidence_pass:
            outcome = "passed"
        column = best.column if best.column < self._n_columns else 0
        share = self.explained
        return Response(outcome, name, also, column=column, explained=share, statistics=own)

    def _alike(self, best: int) -> tuple[str, ...]:
        behind = self._evidence[best] - self._evidence[self._faults]
        close = self._faults[behind < self._config.evidence_alike].tolist()
        return tuple(sorted({self.claims[i].fault for i in close} - {self.claims[best].fault}))

    def _estimated_times(self) -> list[float]:
        """Return lags and dead times, each with its standard deviation.

        They are means over the claims, weighted by their likelihood (all alike beforehand).
        """
        weight = np.exp(self._evidence - self._evidence.max())
        weight /= weight.sum()
        mean, square = (self._moments @ weight[:, np.newaxis]).reshape(2, -1)
        std = np.sqrt(np.maximum(square - mean**2, 0.0))
        times: list[float] = np.column_stack((mean, std)).ravel().tolist()
        return times

    def _gain(self, column: int) -> tuple[float | None, float | None]:
        """Return a column's gain with its standard deviation; None before a window moved."""
        moved, square, ratio = self._amplitudes[:, column].tolist()
        if not moved:
            return None, None
        share, least = square / moved, self._config.gain_least
        relative = (math.exp(ratio / moved) - 1.0 + share) / share
        gain = self._limits.gain_expected * math.sqrt(max(relative, least**2))
        return gain, gain * math.sqrt(0.5 / moved) / self._limits.evidence_gain


def whitened(x: FloatArray, memory: float) -> FloatArray:
    """Return the new part of each sample of windows, (w, n, ...), its mean taken off.

    memory : correlation of neighbouring samples
    """
    new: FloatArray = x[:, 1:] - memory * x[:, :-1]
    new -= new.mean(axis=1, keepdims=True)
    return new
