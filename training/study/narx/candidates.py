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
ALGORITHMS: Final = {
    LM: "Levenberg–Marquardt",
    BAYES: "Bayesian regularisation",
    CONJUGATE: "scaled conjugate gradient",
    DESCENT: "gradient descent with momentum and adaptive rate",
}
PAPER, HERE = "paper", "chosen here"


@dataclass(frozen=True, slots=True)
class Candidate:
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

        >>> Candidate(1, LM, 5, (8, 8), 0.2).name
        'LM, 5 lags, 8-8, rate 0.2'
        """
        rate = "" if self.rate is None else f", rate {self.rate:g}"
        return f"{self.algorithm}, {self.lags} lags, {'-'.join(map(str, self.hidden))}{rate}"

    @property
    def training(self) -> tuple[object, ...]:
        """Return the properties that decide the training; models with equal ones are the same."""
        rate = self.rate if self.algorithm == DESCENT else None
        return (self.algorithm, self.lags, self.hidden, rate)


CANDIDATES: Final = (
    Candidate(number=1, algorithm=LM, lags=5, hidden=(8, 8), rate=0.2, origin=PAPER),
    Candidate(2, LM, 5, (8, 8), 0.1),
    Candidate(3, LM, 5, (8, 8), 0.01),
    Candidate(4, LM, 3, (8, 8)),
    Candidate(5, LM, 8, (8, 8)),
    Candidate(6, LM, 3, (5,)),
    Candidate(7, LM, 5, (5,)),
    Candidate(8, LM, 8, (5,)),
    Candidate(9, LM, 3, (10,)),
    Candidate(10, LM, 5, (10,)),
    Candidate(11, LM, 8, (10,)),
    Candidate(12, LM, 3, (15,)),
    Candidate(13, LM, 5, (15,)),
    Candidate(14, LM, 5, (5, 5)),
    Candidate(15, LM, 5, (10, 10)),
    Candidate(16, LM, 5, (15, 15)),
    Candidate(17, BAYES, 5, (5,)),
    Candidate(18, BAYES, 5, (10,)),
    Candidate(19, BAYES, 3, (8, 8)),
    Candidate(20, BAYES, 5, (8, 8)),
    Candidate(21, CONJUGATE, 5, (5,)),
    Candidate(22, CONJUGATE, 5, (10,)),
    Candidate(23, CONJUGATE, 3, (8, 8)),
    Candidate(24, CONJUGATE, 5, (8, 8)),
    Candidate(25, CONJUGATE, 8, (8, 8)),
    Candidate(26, DESCENT, 5, (8, 8), 0.01),
    Candidate(27, DESCENT, 5, (8, 8), 0.05),
    Candidate(28, DESCENT, 5, (8, 8), 0.2),
    Candidate(29, DESCENT, 5, (15,), 0.2),
)


def same_as(candidates: Sequence[Candidate]) -> dict[int, int]:
    """Return, for every repeated model number, the number of the first model with its training.

    >>> same_as(CANDIDATES)
    {2: 1, 3: 1}
    """
    first: dict[tuple[object, ...], int] = {}
    for candidate in candidates:
        first.setdefault(candidate.training, candidate.number)
    return {c.number: first[c.training] for c in candidates if first[c.training] != c.number}
