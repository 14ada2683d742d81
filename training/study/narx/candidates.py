"""The 29 models of the NARX study.

*Model Based Diagnosis of Oxygen Sensors* compares 29 networks but does not list them. It gives the
chosen network and the ranges: lags 3, 5 and 8, one or two hidden layers, 5 to 15 neurons, several
learning rates, four algorithms. The other 28 networks are chosen here to cover these ranges.

Only gradient descent has a learning rate. Models of another algorithm that differ only in the
learning rate are the same model; they are trained once, and the table says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

LM, BAYES, CONJUGATE, DESCENT = "LM", "Bayesian", "SCG", "GD"
PAPER, HERE = "paper", "chosen here"


@dataclass(frozen=True, slots=True)
class ModelCandidate:
    """One model of the study."""

    number: int
    algorithm: str
    lags: int
    hidden: tuple[int, ...]
    rate: float | None = None  # learning rate, used by gradient descent only
    origin: str = HERE

    @property
    def name(self) -> str:
        """Return the model's name in tables.

        >>> ModelCandidate(1, LM, 5, (8, 8), 0.2).name
        'LM, 5 lags, 8-8, rate 0.2'
        """
        rate = "" if self.rate is None else f", rate {self.rate:g}"
        return f"{self.algorithm}, {self.lags} lags, {'-'.join(map(str, self.hidden))}{rate}"

    @property
    def training(self) -> tuple[object, ...]:
        """Return the properties that decide the training; models with equal ones are the same."""
        rate = self.rate if self.algorithm == DESCENT else None
        return (self.algorithm, self.lags, self.hidden, rate)


# Algorithm, then lags, layers and rate of each model in the order of the numbers from 1.
_TABLE: Final = (
    (LM, "5 8-8 0.2, 5 8-8 0.1, 5 8-8 0.01, 3 8-8, 8 8-8, 3 5, 5 5, 8 5"),
    (LM, "3 10, 5 10, 8 10, 3 15, 5 15, 5 5-5, 5 10-10, 5 15-15"),
    (BAYES, "5 5, 5 10, 3 8-8, 5 8-8"),
    (CONJUGATE, "5 5, 5 10, 3 8-8, 5 8-8, 8 8-8"),
    (DESCENT, "5 8-8 0.01, 5 8-8 0.05, 5 8-8 0.2, 5 15 0.2"),
)


_ROWS: Final = [(algorithm, *row.split()) for algorithm, rows in _TABLE for row in rows.split(", ")]
CANDIDATES: Final = tuple(
    ModelCandidate(
        number,
        algorithm,
        int(lags),
        hidden=tuple(map(int, layers.split("-"))),
        rate=float(rate[0]) if rate else None,
        origin=PAPER if number == 1 else HERE,
    )
    for number, (algorithm, lags, layers, *rate) in enumerate(_ROWS, 1)
)


def same_as(candidates: Sequence[ModelCandidate]) -> dict[int, int]:
    """Return, for every repeated model number, the number of the first model with its training.

    >>> same_as(CANDIDATES)
    {2: 1, 3: 1}
    """
    first = {c.training: c.number for c in reversed(candidates)}
    return {c.number: first[c.training] for c in candidates if first[c.training] != c.number}
