"""Random drives out of pieces of real ones, with faults and with all that no sample should hold."""

from collections.abc import Sequence

import numpy as np

from monitor.base.types import FloatArray

ODD = (np.nan, np.inf, -np.inf, 0.0, -1e30, 1e30, 1e-30, 3.4e38)
FLAGS = ("fuel_cut", "closed_loop", "sensor_ready")
QUALITIES = 7


def drive_of(
    random: np.random.Generator, logs: Sequence[FloatArray], names: Sequence[str]
) -> FloatArray:
    """Return a drive, (n, n_names + 1); its last column is the quality of the lambda signal."""
    pieces = []
    for _ in range(random.integers(2, 6)):
        log, n = logs[random.integers(len(logs))], int(random.integers(50, 900))
        begin = int(random.integers(max(len(log) - n, 1)))
        piece = log[begin : begin + n].copy()
        for _ in range(random.integers(4)):
            _change(piece, random, names)
        pieces.append(piece)
    return np.concatenate(pieces)


def _change(x: FloatArray, random: np.random.Generator, names: Sequence[str]) -> None:
    begin, end = sorted(random.integers(0, len(x) + 1, 2).tolist())
    inside, n, at = slice(begin, end), end - begin, names.index("lambda_measured")
    column, few = int(random.integers(len(names))), random.random(len(x)) < 0.03
    reading = np.where(x[inside, at] == 0.0, np.float32(1e-9), x[inside, at])
    match random.integers(10):
        case 0:
            x[inside, at] = reading + random.normal(0.0, 0.1)
        case 1:
            x[inside, at] = 1.0 / (1.0 + random.uniform(0.1, 1.5) * (1.0 / reading - 1.0))
        case 2:
            x[inside, at] = x[min(begin, len(x) - 1), at]
        case 3:
            x[inside, column] = random.choice(ODD)
        case 4:
            x[few, column] = random.choice(ODD)
        case 5:
            x[inside, -1] = random.integers(QUALITIES)
        case 6:
            x[few, -1] = random.integers(QUALITIES)
        case 7:
            x[inside, names.index(str(random.choice(FLAGS)))] = random.integers(2)
        case 8:
            x[inside, :-1] *= random.lognormal(0.0, 2.0, (n, len(names)))
        case 9:
            x[inside, at] = np.roll(reading, random.integers(30)) + random.normal(0.0, 0.01, n)
