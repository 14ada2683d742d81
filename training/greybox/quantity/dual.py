"""Forward differentiation: arrays (n,) that carry their derivatives over parameters.

Source: Griewank and Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, chapter 3.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from monitor.base.types import FloatArray


@dataclass(frozen=True, slots=True)
class ParameterGroup:
    """Parameters that enter the equations in one place: a constant, or the knots of a field."""

    name: str
    shares: FloatArray | None = field(default=None, compare=False)  # (n, k) of knots at samples

    def spread(self, slope: FloatArray | float, n: int) -> FloatArray:
        """Return the derivatives (n, k) over the parameters for those over the value there."""
        if np.ndim(slope) == 2:
            return np.asarray(slope)
        column = np.full((n, 1), np.reshape(slope, (-1, 1)))
        return column if self.shares is None else column * self.shares[:n]


def _chosen(y: Any, a: Any, b: Any) -> Any:
    """Return the derivative of the larger or smaller one over the first."""
    first = np.equal(y, a)
    return 1.0 if first.all() else first


RULES: Final[Mapping[Any, tuple[Callable[..., Any], ...]]] = {  # over each operand, by the result
    np.add: (lambda y, a, b: 1.0, lambda y, a, b: 1.0),
    np.subtract: (lambda y, a, b: 1.0, lambda y, a, b: -1.0),
    np.multiply: (lambda y, a, b: b, lambda y, a, b: a),
    np.divide: (lambda y, a, b: 1.0 / b, lambda y, a, b: -y / b),
    np.power: (lambda y, a, b: b * y / a, lambda y, a, b: np.log(a) * y),
    np.negative: (lambda y, a: -1.0,),
    np.exp: (lambda y, a: y,),
    np.log: (lambda y, a: np.exp(-y),),
    np.tanh: (lambda y, a: 1.0 - y * y,),
    np.maximum: (_chosen, lambda y, a, b: y != a),
    np.minimum: (_chosen, lambda y, a, b: y != a),
}


@dataclass(frozen=True, slots=True, eq=False)
class Dual(NDArrayOperatorsMixin):
    """A number or values (n,) with their derivatives; numpy's functions and operators apply.

    slopes : of each group over its value at the sample itself, a number or (n,), or, since past
        samples count, over its parameters, (n, k)
    """

    value: Any
    slopes: Mapping[ParameterGroup, Any]

    def __array_ufunc__(self, of: np.ufunc, _method: str, *operands: Any) -> Any:
        values = [value_of(x) for x in operands]
        y = of(*values)
        duals = zip(operands, RULES[of], strict=True)
        return moved(y, *((x, rule(y, *values)) for x, rule in duals if isinstance(x, Dual)))

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
