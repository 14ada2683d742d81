"""Decision rules on a window of measured and predicted values.

``paper_failed`` is the rule of *Model Based Diagnosis of Oxygen Sensors*. ``ResponseRule`` asks
which sensor hypothesis, run on the prediction, explains the measurement best, and sums the
evidence over windows. ``BiasRule`` watches the mean residual.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from monitor.config import BiasConfig, ResponseConfig
from monitor.hypotheses import Hypothesis
from monitor.types import FloatArray, IntArray

Outcome = Literal["passed", "failed", "inconclusive"]


def paper_failed(mean: float, std: float, j_mu: float, j_sigma: float) -> bool:
    """Return the paper's verdict on a window of residuals: both limits reached."""
    return abs(mean) >= j_mu and std >= j_sigma


@dataclass(frozen=True, slots=True)
class Response:
    """What the response rule says after a window."""

    outcome: Outcome
    fault: str | None
    also: tuple[str, ...]
    statistics: dict[str, float | str | None]


class ResponseRule:
    """Sequential comparison of sensor hypotheses, constant memory.

    In each window the measurement is regressed on what each hypothesis reads (gain and offset by
    least squares), and the concentrated Gaussian log likelihood, with the number of independent
    samples in place of the number of samples, is added to the hypothesis's evidence, which fades
    by ``evidence_memory`` per window (Basseville and Nikiforov, Detection of Abrupt Changes,
    chapter 4: log likelihood ratios summed until a threshold).
    """

    def __init__(
        self,
        config: ResponseConfig,
        hypotheses: tuple[Hypothesis, ...],
        noise_std: float,
        excitation_min: float,
        period_s: float,
    ) -> None:
        self._config = config
        self._hypotheses = hypotheses
        self._noise_var = noise_std**2
        self._excitation_min = excitation_min
        self._period_s = period_s
        self._faulty = np.array([h.beyond_limit for h in hypotheses])
        self._faults, self._sound = np.flatnonzero(self._faulty), np.flatnonzero(~self._faulty)
        self.reset()

    def reset(self) -> None:
        """Forget all evidence."""
        n = len(self._hypotheses)
        self._evidence = np.zeros(n)
        self._sxx = np.zeros(n)
        self._sxy = np.zeros(n)
        self._windows = 0

    def judge(self, measured: FloatArray, bank: FloatArray, *, ignore: bool = False) -> Response:
        """Return the verdict after one more window; an ignored one is inconclusive.

        measured : (n,) phi, or the output oriented like it
        bank : (n, n_hypotheses) what each hypothesis reads, column 0 the prediction itself
        """
        n = len(measured)
        y = measured - np.add.reduce(measured) / n
        x = bank - np.add.reduce(bank) / n
        excitation = math.sqrt(np.add.reduce(x[:, 0] ** 2) / n)
        if ignore or excitation < self._excitation_min:
            return self._report("inconclusive", None, (), excitation)
        sxx = np.einsum("ij,ij->j", x, x)
        sxy = y @ x
        gain = np.minimum(np.maximum(sxy / np.maximum(sxx, 1e-12), 0.0), 1.5)
        sse = y @ y - 2.0 * gain * sxy + gain**2 * sxx
        independent = n * self._period_s / self._config.noise_correlation_s
        log_likelihood = -0.5 * independent * np.log(np.maximum(sse, 0.0) / n + self._noise_var)
        memory = self._config.evidence_memory
        self._evidence = memory * self._evidence + (log_likelihood - log_likelihood[0])
        self._sxx = memory * self._sxx + sxx
        self._sxy = memory * self._sxy + sxy
        self._windows += 1
        return self._decide(excitation)

    def _decide(self, excitation: float) -> Response:
        config = self._config
        healthy = self._best_of(self._sound)
        faulty = self._best_of(self._faults)
        margin = float(self._evidence[faulty] - self._evidence[healthy])
        if margin >= config.evidence_fail:
            return self._report("failed", self._name(faulty), self._alike(faulty), excitation)
        gain, gain_std = self._gain(healthy)
        if margin <= -config.evidence_pass:  # in time; is it strong enough, too?
            if gain + 2.0 * gain_std < config.gain_limit:
                return self._report("failed", "gain_low", (), excitation)
            if gain - 2.0 * gain_std > config.gain_limit:
                return self._report("passed", None, (), excitation)
        return self._report("inconclusive", None, (), excitation)

    def _best_of(self, places: IntArray) -> int:
        return int(places[self._evidence[places].argmax()])

    def _gain(self, i: int) -> tuple[float, float]:
        sxx = max(self._sxx.item(i), 1e-12)
        spread = math.sqrt(
            self._noise_var * self._config.noise_correlation_s / self._period_s / sxx
        )
        return self._sxy.item(i) / sxx, spread

    def _name(self, i: int) -> str:
        fault = self._hypotheses[i].fault
        weak = self._gain(i)[0] < self._config.gain_transient
        return "transient" if fault == "slow_symmetric" and weak else fault

    def _alike(self, best: int) -> tuple[str, ...]:
        close = self._evidence[best] - self._evidence < self._config.evidence_alike
        names = {self._name(int(i)) for i in np.flatnonzero(close & self._faulty)}
        return tuple(sorted(names - {self._name(best)}))

    def _report(
        self, outcome: Outcome, fault: str | None, also: tuple[str, ...], excitation: float
    ) -> Response:
        best = int(self._evidence.argmax())
        h = self._hypotheses[best]
        gain, gain_std = self._gain(best)
        seen = self._windows > 0
        statistics: dict[str, float | str | None] = {
            "excitation": excitation,
            "evidence": float(
                self._evidence[self._faults].max() - self._evidence[self._sound].max()
            ),
            "hypothesis": h.fault or "healthy",
            "dead_time_s": h.seconds if h.kind == "delay" else 0.0,
            "lag_s": h.seconds if h.kind == "slow" else 0.0,
            "gain": gain if seen else None,
            "gain_std": gain_std if seen else None,
        }
        return Response(outcome, fault, also, statistics)


@dataclass(frozen=True, slots=True)
class Bias:
    """What the bias rule says after a window."""

    outcome: Outcome
    fault: str | None
    also: tuple[str, ...]
    offset: float  # mean residual over the last windows, output's unit


class BiasRule:
    """Mean residual over several windows against a limit, in the output's unit."""

    def __init__(self, config: BiasConfig, limit: float) -> None:
        self._limit = limit
        self._needed = config.n_windows
        self._means: deque[float] = deque(maxlen=config.n_windows)

    def reset(self) -> None:
        """Forget the windows seen."""
        self._means.clear()

    def judge(self, mean: float, *, ignore: bool = False) -> Bias:
        """Return the verdict after one more window; an ignored one is inconclusive."""
        if not ignore:
            self._means.append(mean)
        offset = sum(self._means) / max(len(self._means), 1)
        if ignore or len(self._means) < self._needed:
            return Bias("inconclusive", None, (), offset)
        if abs(offset) < self._limit:
            return Bias("passed", None, (), offset)
        return Bias("failed", "biased_lean" if offset > 0.0 else "biased_rich", (), offset)
