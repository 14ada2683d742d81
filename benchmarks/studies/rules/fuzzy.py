"""Fuzzy rule: the membership of a window in clusters of faulty windows.

*Model Based Diagnosis of Oxygen Sensors* proposes this rule as further work. The clustering stands
here because scikit-fuzzy would save only a few lines.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from benchmarks.studies.rules.windows import Windows, limit_for
from monitor.base.types import FloatArray

FEATURES = (
    "residual mean",
    "residual std",
    "residual roughness",
    "spread of measured over predicted",
    "correlation",
    "lateness",
    "mean residual rising against falling",
)
CLUSTERS = 8
FUZZINESS = 2.0
ITERATIONS = 200
TOLERANCE = 1e-6


def features(windows: Windows) -> FloatArray:
    """Return the features of each window, (n, 7), in the order of ``FEATURES``.

    The first three features and the last have the output's unit. The ratio of spreads is a
    logarithm. Lateness, in samples, is the least-squares slope of the residual over the negative
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

    With faulty windows, the rule clusters healthy and faulty windows together and stores the faulty
    share of every cluster. Without faulty windows, all clusters are healthy, and the score is the
    membership in a noise cluster, which rises with the distance from all clusters.
    Source of the noise cluster: Davé, Characterization and detection of noise in clustering,
    Pattern Recognition Letters 12, 1991.
    """

    centre: FloatArray  # (n_features,) medians of healthy features
    scale: FloatArray  # (n_features,) robust standard deviations of healthy features
    centres: FloatArray  # (n_clusters, n_features), scaled
    share: FloatArray | None  # (n_clusters,) faulty share, None without faulty windows
    limit: float  # of the membership

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows | None, false_alarm_rate: float) -> Self:
        """Return the rule; healthy and faulty windows weigh the same in total.

        Raises RecordingError if there are too few healthy windows.
        """
        sound = features(healthy)
        low, centre, high = np.quantile(sound, [0.25, 0.5, 0.75], axis=0)
        scale = np.maximum((high - low) / 1.349, 1e-9)  # 1.349: quartile range of a unit normal
        x = np.arcsinh((sound - centre) / scale)
        share = None
        if faulty is None or len(faulty) == 0:
            centres = cluster(x, min(CLUSTERS // 2, len(x)), np.ones(len(x)))
        else:
            other = np.arcsinh((features(faulty) - centre) / scale)
            both = np.vstack([x, other])
            kind = np.repeat([0.0, 1.0], [len(x), len(other)])
            weight = np.where(kind > 0.0, 1.0 / len(other), 1.0 / len(x))
            centres = cluster(both, min(CLUSTERS, len(both)), weight)
            belongs = memberships(both, centres) * weight[:, np.newaxis]
            share = (belongs * kind[:, np.newaxis]).sum(axis=0) / belongs.sum(axis=0)
        rule = cls(centre, scale, centres, share, np.inf)
        limit = limit_for(rule.score(healthy), false_alarm_rate)
        return cls(centre, scale, centres, share, limit)

    def score(self, windows: Windows) -> FloatArray:
        """Return the membership of each window in the faulty or noise clusters, (n,), 0 to 1."""
        x = np.arcsinh((features(windows) - self.centre) / self.scale)
        if self.share is not None:
            return np.asarray(memberships(x, self.centres) @ self.share)
        near = (x.shape[1] / _distances(x, self.centres)).sum(axis=1)
        return np.asarray(1.0 / (1.0 + near))

    def faulty(self, windows: Windows) -> np.ndarray:
        """Return the verdict on each window, (n,) bool."""
        return self.score(windows) >= self.limit


def _distances(x: FloatArray, centres: FloatArray) -> FloatArray:
    """Return the squared distances of points and centres, (n, n_clusters), all above 0."""
    square = ((x[:, np.newaxis, :] - centres[np.newaxis]) ** 2).sum(axis=2)
    return np.asarray(np.maximum(square, 1e-12))
