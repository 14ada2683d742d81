"""Forward differentiation: arrays (n,) that carry their derivatives over parameters.

Source: Griewank and Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, chapter 3.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor.base.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ParameterGroup:
    """Parameters that enter the equations in one place: a constant, or the knots of a field."""

    name: str
    shares: FloatArray | None = None  # (n, k) of the knots in the field at each sample

    def spread(self, slope: FloatArray | float, n: int) -> FloatArray:
        """Return the derivatives (n, k) over the parameters for those over the value there."""
        if np.ndim(slope) == 2:
            return np.asarray(slope)
        column = np.full((n, 1), np.reshape(slope, (-1, 1)))
        return column if self.shares is None else column * self.shares[:n]


@dataclass(frozen=True, slots=True, eq=False)
class Dual:
    """A number or values (n,) with their derivatives.

    slopes : of each group over its value at the sample itself, a number or (n,), or, since past
        samples count, over its parameters, (n, k)
    """

    value: Any
    slopes: Mapping[ParameterGroup, Any]

    __array_ufunc__ = None  # so that an array on the left leaves the operation to the dual

    def __add__(self, other: "Dual | FloatArray | float") -> "Dual":
        return moved(self.value + value_of(other), (self, 1.0), (other, 1.0))

    __radd__ = __add__

    def __sub__(self, other: "Dual | FloatArray | float") -> "Dual":
        return moved(self.value - value_of(other), (self, 1.0), (other, -1.0))

    def __rsub__(self, other: FloatArray | float) -> "Dual":
        return moved(other - self.value, (self, -1.0))

    def __mul__(self, other: "Dual | FloatArray | float") -> "Dual":
        by = value_of(other)
        return moved(self.value * by, (self, by), (other, self.value))

    __rmul__ = __mul__

    def __truediv__(self, other: "Dual | FloatArray | float") -> "Dual":
        by = value_of(other)
        ratio = self.value / by
        return moved(ratio, (self, 1.0 / by), (other, -ratio / by))

    def __rtruediv__(self, other: FloatArray | float) -> "Dual":
        ratio = other / self.value
        return moved(ratio, (self, -ratio / self.value))

    def __neg__(self) -> "Dual":
        return moved(-self.value, (self, -1.0))

    def __rpow__(self, other: FloatArray | float) -> "Dual":
        power = other**self.value
        return moved(power, (self, np.log(other) * power))

    def spread(self, group: ParameterGroup) -> FloatArray:
        """Return the derivatives (n, k) over the parameters of a group."""
        return group.spread(self.slopes[group], len(self.value))


def value_of(x: Any) -> Any:
    """Return a dual's value, anything else as it is."""
    return x.value if isinstance(x, Dual) else x


def moved(value: Any, *parts: tuple[Any, Any]) -> Dual:
    """Return a dual of this value from its operands and the partial derivatives over them.

    >>> gain = ParameterGroup("gain")
    >>> moved(6.0, (Dual(2.0, {gain: 1.0}), 3.0)).slopes[gain]
    3.0
    """
    slopes: dict[ParameterGroup, Any] = {}
    for x, partial in parts:
        for group, slope in x.slopes.items() if isinstance(x, Dual) else ():
            own = slope
            if np.ndim(partial) or partial != 1.0:  # most derivatives are large arrays
                own = slope * (np.reshape(partial, (-1, 1)) if np.ndim(slope) == 2 else partial)
            slopes[group] = _sum(group, slopes[group], own) if group in slopes else own
    return Dual(value, slopes)


def _sum(group: ParameterGroup, a: Any, b: Any) -> Any:
    if np.ndim(a) == np.ndim(b) or max(np.ndim(a), np.ndim(b)) < 2:
        return a + b
    wide, own = (a, b) if np.ndim(a) == 2 else (b, a)
    return group.spread(own, len(wide)) + wide
