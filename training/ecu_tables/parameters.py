"""The parameters of the tables' fit, their priors, and the laws that join neighbouring cells.

Each law is smooth physics with a few constants: a dead time of revolutions, pipe volume over
flow and a rest; lags of mixed volume over flow and of the sensor; a wall film (Aquino, SAE 810494)
whose share and time follow load, speed and coolant. On each law lies a field over speed and load,
so that a cell can differ from the law where its samples say so: bilinear between knots, with a
smooth Gaussian prior. The knots follow the drives and not the axes of a table, so that the estimate
of a cell does not depend on how fine the table is.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Final, NamedTuple

import numpy as np

from monitor.base.types import FloatArray
from training.ecu_tables.signals import Air, TableSubject
from training.greybox.quantity.dual import Dual, ParameterGroup
from training.greybox.quantity.value import Quantity, cells, clip, exp, knots_over, maximum, tanh
from training.recordings.ecu_table import KPA

FLOW_REFERENCE_KG_H: Final = 40.0
SPEED_REFERENCE_RPM: Final = 2000.0
LOAD_REFERENCE: Final = {KPA: 50.0, "air_mass_mg": 250.0}
FLOW_LEAST_KG_H: Final = 3.0
SHARE_MOST: Final = 0.85
LOG_TIME, LOG_TIME_SPAN = -0.8, 1.8  # a film evaporates within 0.07 to 2.7 s, never slower
KNOTS: Final = 5  # of a field, in each direction
REACH: Final = 1.2  # knots: length over which the prior holds neighbours together
NUGGET: Final = 0.02  # of the prior's variance, that no neighbour shares
EDGES: Final = (0.01, 0.99)  # quantiles of the samples between which the knots stand


@dataclass(frozen=True, slots=True)
class Grid:
    """Knots over the logarithms of speed and load."""

    speeds: FloatArray  # (n,) log rpm
    loads: FloatArray  # (m,) log of the load

    @property
    def size(self) -> int:
        """Return the number of knots."""
        return len(self.speeds) * len(self.loads)

    def shares(self, rpm: FloatArray, load: FloatArray) -> FloatArray:
        """Return the knots' shares (n, size) at places (n,); beyond the knots they are constant."""
        return cells(np.log(rpm), np.log(np.maximum(load, 1.0)), (self.speeds, self.loads))

    def precision(self, sd: float) -> FloatArray:
        """Return the inverse of the prior's covariance (size, size)."""
        i, j = np.divmod(np.arange(self.size), len(self.loads))
        apart = (i[:, None] - i) ** 2 + (j[:, None] - j) ** 2
        covariance = sd**2 * ((1 - NUGGET) * np.exp(-0.5 * apart / REACH**2))
        return np.asarray(np.linalg.inv(covariance + sd**2 * NUGGET * np.eye(self.size)))


def grid_over(rpm: FloatArray, load: FloatArray, knots: int = KNOTS) -> Grid:
    """Return ``knots`` in each direction over the places (n,) that the drives visit."""
    both = (np.log(np.maximum(each, 1.0)) for each in (rpm, load))
    return Grid(*(knots_over(each, knots, EDGES, 0.1) for each in both))


SCALARS: Final = {  # constant → mean and standard deviation of its prior
    "flow": (0.0, 2.0),  # log of injected fuel over the unit of the command
    "dead_ms": (-0.35, 0.6),  # log of the injector's dead time at 14 V in ms
    "dead_exponent": (1.6, 0.4),  # of 14 V over the voltage
    "filling": (5.94, 0.4),  # log of the manifold's time constant times rpm
    "meter": (-3.7, 0.5),  # log of the air meter's time constant in s
    "charge_s": (0.0, 0.03),  # the charge behind the logged pressure
    "delay_s": (0.03, 0.03),
    "delay_rev": (1.5, 0.1),  # intake, compression, expansion, half the exhaust stroke
    "gas_heat": (0.1, 0.03),  # exponent of the flow in the gas's temperature
    "delay_flow": (0.7, 1.0),  # log of s kg/h, at 40 kg/h
    "mixed_flow": (-1.0, 0.8),  # log of s kg/h
    "sensor_s": (-2.4, 0.4),  # log, at 40 kg/h
    "sensor_flow": (0.25, 0.12),  # share of the sensor's lag that falls with flow
    "film": (-1.5, 1.2),  # log odds of the share, warm
    "film_cold": (1.0, 0.6),
    "film_load": (0.2, 0.3),
    "film_speed": (-0.1, 0.3),
    "time": (-0.7, 0.5),  # log s, warm
    "time_cold": (0.7, 0.4),
    "time_load": (-0.2, 0.3),
    "time_speed": (-0.2, 0.3),
    "span": (1.0, 0.2),  # of the reading about phi 1: an air that errs in time weakens it
}
FUEL: Final = ("flow", "dead_ms", "dead_exponent")
FIELD_SD: Final = {"gain": 0.05, "delay": 0.15, "lag": 0.12, "share": 0.15, "tau": 0.12}
GAIN_SD_WITHOUT_VE: Final = 0.15


class Balance(NamedTuple):
    """Logarithms of flow and of dead time in ms, and the exponent of the dead time."""

    mean: FloatArray  # (3,)
    covariance: FloatArray  # (3, 3)
    seconds: float  # of steady samples


@dataclass(frozen=True)
class Parameters:
    """Names, places and priors of one fit's parameter vector."""

    subject: TableSubject
    grid: Grid
    fuel: Balance | None = None  # of flow and dead time, which else have their priors

    @cached_property
    def at(self) -> dict[str, slice]:
        """Return where each constant and field stands in the vector."""
        sizes = dict.fromkeys(SCALARS, 1) | dict.fromkeys(FIELD_SD, self.grid.size)
        ends = accumulate(sizes.values())
        return {n: slice(end - sizes[n], end) for n, end in zip(sizes, ends, strict=True)}

    @property
    def size(self) -> int:
        """Return the length of the vector."""
        return len(SCALARS) + len(FIELD_SD) * self.grid.size

    def mean(self) -> FloatArray:
        """Return the prior's mean."""
        x = np.zeros(self.size)
        x[: len(SCALARS)] = [mean for mean, _ in SCALARS.values()]
        if self.fuel is not None:
            x[: len(FUEL)] = self.fuel.mean
        return x

    def precision(self) -> FloatArray:
        """Return the inverse of the prior's covariance (size, size)."""
        full = np.zeros((self.size, self.size))
        for k, (_, sd) in enumerate(SCALARS.values()):
            full[k, k] = sd**-2.0
        if self.fuel is not None:
            full[: len(FUEL), : len(FUEL)] = np.linalg.inv(self.fuel.covariance)
        wide = {"gain": GAIN_SD_WITHOUT_VE} if self.subject.air is Air.SPEED_DENSITY else {}
        for name, sd in (FIELD_SD | wide).items():
            full[self.at[name], self.at[name]] = self.grid.precision(sd)
        return full

    def jacobian(self, of: Dual) -> FloatArray:
        """Return the derivatives (n, size) of a quantity over all parameters."""
        full = np.zeros((len(of.value), self.size))
        for group in of.slopes:
            full[:, self.at[group.name]] = of.spread(group)
        return full


@dataclass(frozen=True)
class Vector:
    """Values of the parameters; with ``moving``, all that is made of them has its derivatives."""

    p: Parameters
    x: FloatArray
    moving: bool = False

    def __getitem__(self, constant: str) -> Quantity:
        return self._dual(constant, float(self.x[self.p.at[constant].start]))

    def field(self, name: str, at: "Point") -> Quantity:
        """Return one field (n,) at places."""
        return self._dual(name, at.shares @ self.x[self.p.at[name]], at.shares)

    def _dual(self, name: str, value: Quantity, shares: FloatArray | None = None) -> Quantity:
        if not self.moving:
            return value
        return Dual(value, {ParameterGroup(name, shares): 1.0})


class Point(NamedTuple):
    """Places at which the laws are asked; each (n,)."""

    rpm: FloatArray
    load: FloatArray
    flow_kg_h: FloatArray  # of the exhaust
    cold: FloatArray
    shares: FloatArray  # (n, size) of the fields' knots


def delay_s(v: Vector, at: Point) -> Quantity:
    """Return the dead time from injection to sensor in s at steady operating points."""
    return near_delay_s(v, at) + pipe_kg_h_s(v, at) / gas_flow(v, at)


def gas_flow(v: Vector, at: Point) -> Quantity:
    """Return the volume flow in the exhaust, as kg/h of gas that is as hot as at 40 kg/h.

    Exhaust is hotter, so less dense, at a larger flow: some 450 °C at idle and 800 °C at high
    load (Heywood, Internal Combustion Engine Fundamentals, section 6.5).
    """
    relative = at.flow_kg_h / FLOW_REFERENCE_KG_H
    return at.flow_kg_h * relative ** v["gas_heat"]


def near_delay_s(v: Vector, at: Point) -> Quantity:
    """Return the part of the dead time that is none of the pipe's, in s."""
    revolutions = v["delay_rev"] * 60.0 / at.rpm
    return maximum(v["delay_s"] + revolutions, 0.0)


def pipe_kg_h_s(v: Vector, at: Point) -> Quantity:
    """Return the gas between valve and sensor as flow times time, in s kg/h."""
    return exp(v["delay_flow"] + v.field("delay", at))


def sensor_s(v: Vector, flow_kg_h: FloatArray) -> Quantity:
    """Return the lag of the sensor in s."""
    share = clip(v["sensor_flow"], 0.0, 1.0)
    falls = np.sqrt(FLOW_REFERENCE_KG_H / flow_kg_h)
    return exp(v["sensor_s"]) * (1.0 + share * (falls - 1.0))


def lags_s(v: Vector, at: Point) -> tuple[Quantity, Quantity]:
    """Return the lags of the mixed exhaust volume and of the sensor in s."""
    field = v.field("lag", at)
    mixing_s = exp(v["mixed_flow"] + field) / gas_flow(v, at)
    return mixing_s, sensor_s(v, at.flow_kg_h) * exp(field)


def film_odds(v: Vector, at: Point) -> Quantity:
    """Return the log odds of the fraction of the fuel that wets the wall."""
    return v["film"] + _law(v, "film", at) + v.field("share", at)


def share_of(odds: Quantity) -> Quantity:
    """Return the fraction of these log odds, at most ``SHARE_MOST``."""
    return SHARE_MOST / (1.0 + exp(-odds))


def film_level(v: Vector, at: Point) -> Quantity:
    """Return the logarithm of the film's time constant as if it had no limits, scaled."""
    free = v["time"] + _law(v, "time", at) + v.field("tau", at)
    return (free - LOG_TIME) / LOG_TIME_SPAN


def time_of(level: Quantity) -> Quantity:
    """Return the film's time constant of a level in s."""
    return exp(LOG_TIME + LOG_TIME_SPAN * tanh(level))


def dead_ms(v: Vector, volts: FloatArray) -> Quantity:
    """Return the dead time of the injectors in ms."""
    return exp(v["dead_ms"] + v["dead_exponent"] * np.log(14.0 / volts))


def _law(v: Vector, of: str, at: Point) -> Quantity:
    """Return how a film's constant moves with temperature, load and speed."""
    load = np.log(np.maximum(at.load, 1.0) / LOAD_REFERENCE[v.p.subject.load])
    speed = np.log(at.rpm / SPEED_REFERENCE_RPM)
    return v[f"{of}_cold"] * at.cold + v[f"{of}_load"] * load + v[f"{of}_speed"] * speed
