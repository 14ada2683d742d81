"""Shapes of an empirical effect: a size as a function of u, a signal moved and scaled.

u is -1 and +1 at the ends of the signal's range. Sizes are in the unit of what the effect acts on.
"""

import math
from dataclasses import dataclass
from typing import Final, Protocol

from training.greybox.effects.form.effect import Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, clip, exp, maximum, minimum, tanh

FARTHEST: Final = 3.0  # |u| beyond which a line goes on level
NEAR: Final = 1.5  # |u| beyond which an exponential goes on level
POSITIVE: Final = 4.0  # makes u positive, for a lag
KNOTS: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)  # of a curve
FIRST: Final = 0.025  # of the largest size: from which a fit begins


@dataclass(frozen=True, slots=True)
class Words:
    """What a formula is written with."""

    signal: str
    at: float  # the signal at u = 0
    width: float  # of the signal, per u
    unit: str  # of a size


class Shape(Protocol):
    """A function of u with constants."""

    def parameters(self, unit: str, most: float) -> tuple[Parameter, ...]:
        """Return its constants, with sizes of at most ``most``."""

    def size(self, place: Place, u: Quantity, values: Values) -> Quantity:
        """Return the size of the effect."""

    def says(self, values: Values, words: Words) -> str:
        """Return it as a formula."""


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line, also behind a lag of first order."""

    late: bool = False

    def parameters(self, unit: str, most: float) -> tuple[Parameter, ...]:
        """Return the size in the middle of the range, the size per u and the lag's time."""
        time = (Parameter("time", "s", 0.3, 60.0, (2.0, 15.0)),) if self.late else ()
        return (_size("middle", unit, most), _size("size", unit, most), *time)

    def size(self, place: Place, u: Quantity, values: Values) -> Quantity:
        """Return the value on the line."""
        u = clip(u, -FARTHEST, FARTHEST)
        if self.late:
            u = place.lag(u + POSITIVE, values[2]) - POSITIVE
        return values[0] + values[1] * u

    def says(self, values: Values, words: Words) -> str:
        """Return the size in the middle and the slope."""
        late = f" behind a lag of {values[2]:.3g} s" if self.late else ""
        slope = f"{_signed(values[1] / words.width)} {words.unit} per unit"
        return (
            f"{_signed(values[0])} {words.unit} {slope} of ({words.signal}{late} - {words.at:.6g})"
        )


@dataclass(frozen=True, slots=True)
class Curve:
    """Straight between five values, level beyond them."""

    def parameters(self, unit: str, most: float) -> tuple[Parameter, ...]:
        """Return the sizes at the knots."""
        return tuple(_size(f"at {u:+g}", unit, most) for u in KNOTS)

    def size(self, place: Place, u: Quantity, values: Values) -> Quantity:
        """Return the value on the curve."""
        inside = clip(u, KNOTS[0], KNOTS[-1])
        apart = KNOTS[1] - KNOTS[0]
        total: Quantity = 0.0
        for knot, value in zip(KNOTS, values, strict=True):
            away = maximum(inside - knot, knot - inside)
            total = maximum(1.0 - away * (1.0 / apart), 0.0) * value + total
        return total

    def says(self, values: Values, words: Words) -> str:
        """Return the sizes at the knots."""
        points = ", ".join(
            f"{v:+.3g} {words.unit} at {words.at + u * words.width:.4g}"
            for u, v in zip(KNOTS, values, strict=True)
        )
        return f"+ curve of {words.signal}: {points}"


@dataclass(frozen=True, slots=True)
class Bump:
    """A resonance: a bell about one value of the signal."""

    def parameters(self, unit: str, most: float) -> tuple[Parameter, ...]:
        """Return the height, and place and half width at 1/e in u."""
        return (_size("size", unit, most), *_PLACE_AND_WIDTH)

    def size(self, place: Place, u: Quantity, values: Values) -> Quantity:
        """Return the value on the bell."""
        z = _from_place(u, values[1], values[2])
        return exp(z * z * -1.0) * values[0]

    def says(self, values: Values, words: Words) -> str:
        """Return height, place and width in the signal's unit."""
        at, width = words.at + values[1] * words.width, values[2] * words.width
        bell = f"exp(-(({words.signal} - {at:.4g}) / {width:.3g})²)"
        return f"{_signed(values[0])} {words.unit} × {bell}"


@dataclass(frozen=True, slots=True)
class Step:
    """One value below a place and another above it: a flap, a valve, a switch."""

    def parameters(self, unit: str, most: float) -> tuple[Parameter, ...]:
        """Return the middle, half the step's height, and place and half width in u."""
        return (_size("middle", unit, most), _size("size", unit, most), *_PLACE_AND_WIDTH)

    def size(self, place: Place, u: Quantity, values: Values) -> Quantity:
        """Return the value on the step."""
        return values[0] + values[1] * tanh(_from_place(u, values[2], values[3]))

    def says(self, values: Values, words: Words) -> str:
        """Return both values, and the place in the signal's unit."""
        middle, half, place, width = values
        at, wide = words.at + place * words.width, 2.0 * width * words.width
        below, above = (_signed(each) for each in (middle - half, middle + half))
        return (
            f"{below} {words.unit} below {words.signal} {at:.4g}, {above} {words.unit} above it "
            f"(over {wide:.2g})"
        )


@dataclass(frozen=True, slots=True)
class Bend:
    """A line that goes on with another slope beyond a place: a threshold, a dead band."""

    def parameters(self, unit: str, most: float) -> tuple[Parameter, ...]:
        """Return the size at the place, the slopes per u below and above it, and the place in u."""
        slopes = (_size("below", unit, most), _size("above", unit, most))
        return (_size("middle", unit, most), *slopes, _PLACE_AND_WIDTH[0])

    def size(self, place: Place, u: Quantity, values: Values) -> Quantity:
        """Return the value on the two lines."""
        away = clip(u, -FARTHEST, FARTHEST) - values[3]
        return values[0] + values[1] * minimum(away, 0.0) + values[2] * maximum(away, 0.0)

    def says(self, values: Values, words: Words) -> str:
        """Return the size at the place and both slopes."""
        middle, below, above, place = values
        at = words.at + place * words.width
        slopes = [f"{_signed(each / words.width)} {words.unit}" for each in (below, above)]
        return (
            f"{_signed(middle)} {words.unit} {slopes[0]} below and {slopes[1]} above "
            f"per unit of ({words.signal} - {at:.4g})"
        )


@dataclass(frozen=True, slots=True)
class Exponential:
    """A size that is multiplied by the same factor per unit: vapour pressure, viscosity."""

    def parameters(self, unit: str, most: float) -> tuple[Parameter, ...]:
        """Return a constant, the size at the end where it is largest, and the rate per u."""
        rate = Parameter("rate", "", -6.0, 6.0, (-2.0, 2.0))
        return (_size("middle", unit, most), _size("size", unit, most), rate)

    def size(self, place: Place, u: Quantity, values: Values) -> Quantity:
        """Return the value on the exponential."""
        middle, size, rate = values
        return middle + size * exp(clip(u, -NEAR, NEAR) * rate - abs(rate))

    def says(self, values: Values, words: Words) -> str:
        """Return the constant, the size at u = 0 and the rate in the signal's unit."""
        middle, size, rate = values
        over = f"exp({rate / words.width:.3g} × ({words.signal} - {words.at:.6g}))"
        first = size * math.exp(-abs(rate))
        return f"{_signed(middle)} {words.unit} {_signed(first)} {words.unit} × {over}"


_PLACE_AND_WIDTH: Final = (
    Parameter("place", "", -1.0, 1.0, (-0.6, -0.2, 0.2, 0.6)),
    Parameter("width", "", 0.05, 0.7, (0.25,)),
)


def _from_place(u: Quantity, place: float, width: float) -> Quantity:
    return (clip(u, -FARTHEST, FARTHEST) - place) * (1.0 / width)


def _size(name: str, unit: str, most: float) -> Parameter:
    return Parameter(name, unit, -most, most, (FIRST * most,))


def _signed(value: float) -> str:
    return f"{'-' if value < 0 else '+'} {abs(value):.3g}"
