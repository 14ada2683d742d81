"""Shapes of an empirical effect: a size as a function of u, a signal moved and scaled.

u is -1 and +1 at the ends of the signal's range. Sizes are in the unit of what the effect acts on.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from monitor.base.counts import plain
from training.greybox.effects.effect import Parameter, Place, Values
from training.greybox.quantity.value import Quantity, clip, exp, linear, maximum, minimum, tanh

FARTHEST: Final = 3.0  # |u| beyond which a line goes on level
NEAR: Final = 1.5  # |u| beyond which an exponential goes on level
POSITIVE: Final = 4.0  # makes u positive, for a lag
KNOTS: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)  # of a curve
FIRST: Final = 0.025  # of the largest size: from which a fit begins


class ScaledSignal(NamedTuple):
    """A signal, moved and scaled: u = (signal - at) / width."""

    signal: str
    at: float
    width: float

    def u(self, place: Place) -> Quantity:
        """Return the scaled signal, level from the farthest value on."""
        scaled = (place.signal(self.signal) - self.at) * (1.0 / self.width)
        return clip(scaled, -FARTHEST, FARTHEST)


class Shape(NamedTuple):
    """A function of u with constants: first the sizes, then the others."""

    sizes: tuple[str, ...]
    others: tuple[Parameter, ...]
    size: Callable[[Place, Quantity, Values], Quantity]
    says: Callable[[Values, ScaledSignal, str], str]  # it as a formula, with the unit of a size

    def parameters(self, unit: str, most: float) -> tuple[Parameter, ...]:
        """Return its constants, with sizes of at most ``most``."""
        sizes = (Parameter(name, unit, -most, most, (FIRST * most,)) for name in self.sizes)
        return (*sizes, *self.others)


def _signed(size: float, unit: str) -> str:
    return f"{'-' if size < 0 else '+'} {plain(abs(size), 3)} {unit}"


def _line(place: Place, u: Quantity, values: Values) -> Quantity:
    return values[0] + values[1] * u


def _late_line(place: Place, u: Quantity, values: Values) -> Quantity:
    return _line(place, place.lag(u + POSITIVE, values[2]) - POSITIVE, values)


def _says_line(values: Values, over: ScaledSignal, unit: str) -> str:
    late = f" behind a lag of {plain(values[2], 3)} s" if len(values) > 2 else ""
    return (
        f"{_signed(values[0], unit)} {_signed(values[1] / over.width, unit)} per unit of "
        f"({over.signal}{late} - {plain(over.at, 6)})"
    )


def _curve(place: Place, u: Quantity, values: Values) -> Quantity:
    return linear(u, np.array(KNOTS), np.array(values))


def _says_curve(values: Values, over: ScaledSignal, unit: str) -> str:
    points = ", ".join(
        f"{plain(v, 3, '+')} {unit} at {plain(over.at + u * over.width)}"
        for u, v in zip(KNOTS, values, strict=True)
    )
    return f"+ curve of {over.signal}: {points}"


def _bump(place: Place, u: Quantity, values: Values) -> Quantity:
    z = (u - values[1]) * (1.0 / values[2])
    return exp(z * z * -1.0) * values[0]


def _says_bump(values: Values, over: ScaledSignal, unit: str) -> str:
    at, width = over.at + values[1] * over.width, values[2] * over.width
    return (
        f"{_signed(values[0], unit)} × exp(-(({over.signal} - {plain(at)}) / {plain(width, 3)})²)"
    )


def _step(place: Place, u: Quantity, values: Values) -> Quantity:
    return values[0] + values[1] * tanh((u - values[2]) * (1.0 / values[3]))


def _says_step(values: Values, over: ScaledSignal, unit: str) -> str:
    middle, half, place, width = values
    at, wide = over.at + place * over.width, 2.0 * width * over.width
    below, above = (_signed(each, unit) for each in (middle - half, middle + half))
    return f"{below} below {over.signal} {plain(at)}, {above} above it (over {plain(wide, 2)})"


def _bend(place: Place, u: Quantity, values: Values) -> Quantity:
    away = u - values[3]
    return values[0] + values[1] * minimum(away, 0.0) + values[2] * maximum(away, 0.0)


def _says_bend(values: Values, over: ScaledSignal, unit: str) -> str:
    middle, *slopes, place = values
    below, above = (_signed(each / over.width, unit) for each in slopes)
    at = over.at + place * over.width
    per = f"per unit of ({over.signal} - {plain(at)})"
    return f"{_signed(middle, unit)} {below} below and {above} above {per}"


def _exponential(place: Place, u: Quantity, values: Values) -> Quantity:
    middle, size, rate = values
    return middle + size * exp(clip(u, -NEAR, NEAR) * rate - abs(rate))


def _says_exponential(values: Values, over: ScaledSignal, unit: str) -> str:
    middle, size, rate = values
    first = _signed(size * math.exp(-abs(rate)), unit)  # at u = 0
    rise = f"exp({plain(rate / over.width, 3)} × ({over.signal} - {plain(over.at, 6)}))"
    return f"{_signed(middle, unit)} {first} × {rise}"


_PLACE: Final = Parameter("place", "", -1.0, 1.0, (-0.6, -0.2, 0.2, 0.6))
_WIDTH: Final = Parameter("width", "", 0.05, 0.7, (0.25,))
_TIME: Final = Parameter("time", "s", 0.3, 60.0, (2.0, 15.0))
_RATE: Final = Parameter("rate", "", -6.0, 6.0, (-2.0, 2.0))
LINE: Final = Shape(("middle", "size"), (), _line, _says_line)
LATE_LINE: Final = Shape(("middle", "size"), (_TIME,), _late_line, _says_line)
# straight between five values, level beyond them
CURVE: Final = Shape(tuple(f"at {u:+g}" for u in KNOTS), (), _curve, _says_curve)
# a resonance: a bell about one value, with its half width at 1/e
BUMP: Final = Shape(("size",), (_PLACE, _WIDTH), _bump, _says_bump)
# a flap, a valve, a switch: a middle, half of the height, half of the width
STEP: Final = Shape(("middle", "size"), (_PLACE, _WIDTH), _step, _says_step)
# a threshold, a dead band: a line that goes on with another slope
BEND: Final = Shape(("middle", "below", "above"), (_PLACE,), _bend, _says_bend)
# vapour pressure, viscosity: multiplied by the same factor per unit, largest at one end
EXPONENTIAL: Final = Shape(("middle", "size"), (_RATE,), _exponential, _says_exponential)
