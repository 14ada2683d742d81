"""Fuzzy rule: the membership of a window in clusters of faulty windows.

*Model Based Diagnosis of Oxygen Sensors* proposes this rule as further work. The clustering stands
here because scikit-fuzzy would save only a few lines.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from benchmarks.studies.rules.windows import Windows, limit_for
from monitor.base.types import FloatArray

CLUSTERS = 8
FUZZINESS = 2.0
ITERATIONS = 200
TOLERANCE = 1e-6


def features(windows: Windows) -> FloatArray:
    """Return the features of each window, (n, 7).

    They are mean, standard deviation and roughness of the residual, the logarithm of measured over
    predicted spread, correlation, lateness, and the mean residual of rising against falling
    predictions. Lateness, in samples, is the least-squares slope of the residual over the negative
    predicted change per sample.
    """
    residual, predicted = windows.residual, windows.predicted
    spread, of_predicted = windows.measured.std(axis=1), predicted.std(axis=1)
    tiny = 1e-6 * max(float(of_predicted.max()), 1e-9)
    change = np.gradient(predicted, axis=1)
    centred = residual - residual.mean(axis=1, keepdims=True)
    power = (change**2).sum(axis=1)
    floor = max(0.1 * float(np.median(power)), 1e-18)  # pulls lateness to 0 in steady windows
    product = (
        (windows.measured - windows.measured.mean(axis=1, keepdims=True))
        * (predicted - predicted.mean(axis=1, keepdims=True))
    ).mean(axis=1)
    rising = np.sign(change)
    return np.column_stack(
        [
            residual.mean(axis=1),
            residual.std(axis=1),
            np.abs(np.diff(residual, axis=1)).mean(axis=1),
            np.log((spread + tiny) / (of_predicted + tiny)),
            product / (spread * of_predicted + tiny**2),
            -(centred * change).sum(axis=1) / (power + floor),
            (centred * rising).mean(axis=1),
        ]
    )


def memberships(x: FloatArray, centres: FloatArray) -> FloatArray:
    """Return the memberships of points in clusters, (n, n_clusters); the rows sum to 1.

    x : (n, n_features); centres : (n_clusters, n_features)
    Source: Bezdek, Pattern Recognition with Fuzzy Objective Function Algorithms, 1981, (11.3a).
    """
    weight = _distances(x, centres) ** (-1.0 / (FUZZINESS - 1.0))
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def cluster(x: FloatArray, n_clusters: int, weight: FloatArray) -> FloatArray:
    """Return the centres of fuzzy c-means, (n_clusters, n_features).

    x : (n, n_features) points; weight : (n,) weights of the points
    The start is not random: the first centres are points far apart. So equal points give equal
    centres.
    Source: Bezdek, 1981, algorithm A11.1.
    """
    centres = x[[int(_distances(x, x.mean(axis=0)[np.newaxis]).argmin())]]
    while len(centres) < n_clusters:
        nearest = _distances(x, centres).min(axis=1)
        order = np.argsort(nearest)
        centres = np.vstack([centres, x[order[int(0.98 * (len(x) - 1))]]])  # not an outlier
    for _ in range(ITERATIONS):
        u = memberships(x, centres) ** FUZZINESS * weight[:, np.newaxis]
        after = (u.T @ x) / u.sum(axis=0)[:, np.newaxis]
        moved, centres = float(np.abs(after - centres).max()), after
        if moved < TOLERANCE:
            break
    return np.asarray(centres)


@dataclass(frozen=True, slots=True)
class FuzzyRule:
    """A window is faulty if its membership in faulty clusters reaches the limit.

    The rule clusters healthy and faulty windows together and keeps the faulty share of every
    cluster.
    """

    centre: FloatArray  # (n_features,) medians of healthy features
    scale: FloatArray  # (n_features,) robust standard deviations of healthy features
    centres: FloatArray  # (n_clusters, n_features), scaled
    share: FloatArray  # (n_clusters,) faulty share
    limit: float  # of the membership

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows, false_alarm_rate: float) -> Self:
        """Return the rule; healthy and faulty windows weigh the same in total."""
        low, centre, high = np.quantile(features(healthy), [0.25, 0.5, 0.75], axis=0)
        scale = np.maximum((high - low) / 1.349, 1e-9)  # 1.349: quartile range of a unit normal
        both = np.vstack(
            [np.arcsinh((features(each) - centre) / scale) for each in (healthy, faulty)]
        )
        kind = np.repeat([0.0, 1.0], [len(healthy), len(faulty)])
        weight = np.where(kind > 0.0, 1.0 / len(faulty), 1.0 / len(healthy))
        centres = cluster(both, min(CLUSTERS, len(both)), weight)
        belongs = memberships(both, centres) * weight[:, np.newaxis]
        share = (belongs * kind[:, np.newaxis]).sum(axis=0) / belongs.sum(axis=0)
        rule = cls(centre, scale, centres, share, np.inf)
        return replace(rule, limit=limit_for(rule.score(healthy), false_alarm_rate))

    def score(self, windows: Windows) -> FloatArray:
        """Return the membership of each window in the faulty clusters, (n,), 0 to 1."""
        x = np.arcsinh((features(windows) - self.centre) / self.scale)
        return np.asarray(memberships(x, self.centres) @ self.share)

    def faulty(self, windows: Windows) -> np.ndarray:
        """Return the verdict on each window, (n,) bool."""
        return self.score(windows) >= self.limit


def _distances(x: FloatArray, centres: FloatArray) -> FloatArray:
    """Return the squared distances of points and centres, (n, n_clusters), all above 0."""
    square = ((x[:, np.newaxis, :] - centres[np.newaxis]) ** 2).sum(axis=2)
    return np.asarray(np.maximum(square, 1e-12))
