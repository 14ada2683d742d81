"""The grey-box chain as arrays: charge and fuel, transport, mixing, sensor.

phi at the valve is stoichiometric ratio · fuel / air · factor. It travels for a dead time and is
mixed by a first-order lag. The sensor pumps 1 + span · (gas - 1) of the mixed gas and reads it
behind a second lag, whose time constant may differ by direction. All values are in phi = 1/lambda,
which is 0 in fuel cut. Lags are exact for inputs that run straight between samples (ramp
invariance; Franklin, Powell, Workman, Digital Control of Dynamic Systems, section 6.3): a time
constant means the same at any sample period.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numba import njit

from monitor.base.types import BoolArray, FloatArray
from monitor.model.step import PHI_MAX

STOICHIOMETRIC = 14.7  # air over fuel by mass; for another fuel the gain differs
AIR_LEAST_MG = 5.0  # per stroke; below it the engine stands
SPEED_LEAST_RPM, SPEED_MOST_RPM = 300.0, 9000.0
PHI_VALVE_MOST = 3.0
TIME_LEAST_S = 1e-4  # time constant of a lag
CYLINDERS = 4  # between air meter, charge and engine speed; for another number constants differ
MG_RPM_PER_KG_H = 1e6 / 3600.0 * 120.0 / CYLINDERS  # four strokes
RECOVERY_S = 2.0  # after fuel cut, before a sample counts


class Constants(NamedTuple):
    """The chain's calibration constants, which a fit may move."""

    gain: float = 1.0  # of fuel over air: injector, air meter and fuel in one
    dead_time_s: float = 0.15  # part without engine speed
    dead_time_revolutions: float = 1.5  # part over engine speed: 90 / rpm seconds
    mixing_s: float = 0.06  # at most sensor_s: the two lags read the same in either order
    sensor_s: float = 0.10
    span: float = 1.0  # sensor sensitivity about phi = 1


@dataclass(frozen=True, slots=True)
class ChainRange:
    """Unit and bounds of one constant."""

    unit: str
    low: float
    high: float


RANGES: Mapping[str, ChainRange] = {
    "gain": ChainRange("-", 0.4, 2.5),
    "dead_time_s": ChainRange("s", 0.0, 1.0),
    "dead_time_revolutions": ChainRange("rev", 0.0, 6.0),
    "mixing_s": ChainRange("s", 0.005, 1.5),
    "sensor_s": ChainRange("s", 0.005, 1.5),
    "span": ChainRange("-", 0.3, 2.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Path:
    """The mixture's way from valve to sensor, each field (n,) at the sample period."""

    fuel_mg: FloatArray  # per stroke, into the cylinder
    air_mg: FloatArray  # per stroke
    factor: FloatArray  # on phi at the valve; the base's gain
    dead_time_s: FloatArray
    mixing_s: FloatArray
    sensor_rising_s: FloatArray  # rising phi is lean to rich
    sensor_falling_s: FloatArray
    gas_factor: FloatArray  # on phi at the sensor, after mixing
    span: FloatArray

    def __len__(self) -> int:
        return len(self.fuel_mg)


def charge_mg(signals: Mapping[str, FloatArray]) -> FloatArray:
    """Return the air per stroke (n,) in mg, as broadcast or from air meter and engine speed.

    >>> charge_mg({"maf_kg_h": np.array([36.0]), "engine_speed_rpm": np.array([1500.0])}).tolist()
    [200.0]
    """
    if "air_mass_mg" in signals:
        return signals["air_mass_mg"]
    rpm = np.maximum(signals["engine_speed_rpm"], SPEED_LEAST_RPM)
    return np.asarray(signals["maf_kg_h"] * MG_RPM_PER_KG_H / rpm)


def with_speed(signals: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the signals with engine speed (n,), as broadcast or from air meter and charge.

    >>> with_speed({"maf_kg_h": np.array([36.0]), "air_mass_mg": np.array([200.0])})[
    ...     "engine_speed_rpm"].tolist()
    [1500.0]
    """
    complete = dict(signals)
    if "engine_speed_rpm" not in complete:
        air_mg = np.maximum(signals["air_mass_mg"], AIR_LEAST_MG)
        rpm = signals["maf_kg_h"] * MG_RPM_PER_KG_H / air_mg
        complete["engine_speed_rpm"] = np.clip(rpm, SPEED_LEAST_RPM, SPEED_MOST_RPM)
    return complete


def inputs_of(available: Collection[str]) -> tuple[str, ...]:
    """Return the inputs of a chain for vehicles with the ``available`` signals.

    If these make no chain, the returned names tell the missing ones.

    >>> inputs_of(["fuel_mass_mg", "air_mass_mg", "maf_kg_h"])
    ('fuel_mass_mg', 'air_mass_mg', 'maf_kg_h')
    """
    if "engine_speed_rpm" not in available and {"air_mass_mg", "maf_kg_h"} <= set(available):
        return ("fuel_mass_mg", "air_mass_mg", "maf_kg_h")
    by_meter = "maf_kg_h" in available and "air_mass_mg" not in available
    return ("fuel_mass_mg", "maf_kg_h" if by_meter else "air_mass_mg", "engine_speed_rpm")


def base_path(constants: Constants, signals: Mapping[str, FloatArray]) -> Path:
    """Return the path of the chain without effects.

    signals : (n,) each: fuel_mass_mg, engine_speed_rpm, and air_mass_mg or maf_kg_h
    """
    fuel_mg = np.asarray(signals["fuel_mass_mg"], dtype=np.float64)
    ones = np.ones(len(fuel_mg))
    revolution_s = 60.0 / np.maximum(signals["engine_speed_rpm"], SPEED_LEAST_RPM)
    sensor_s = constants.sensor_s * ones
    return Path(
        fuel_mg=fuel_mg,
        air_mg=np.asarray(charge_mg(signals), dtype=np.float64),
        factor=constants.gain * ones,
        dead_time_s=constants.dead_time_s + constants.dead_time_revolutions * revolution_s,
        mixing_s=constants.mixing_s * ones,
        sensor_rising_s=sensor_s,
        sensor_falling_s=sensor_s,
        gas_factor=ones,
        span=constants.span * ones,
    )


def valve_phi(path: Path) -> FloatArray:
    """Return phi at the valve (n,), within 0 .. 3."""
    return _valve_phi(path.factor, path.fuel_mg, path.air_mg)


def simulate(path: Path, period_s: float) -> FloatArray:
    """Return the phi that the sensor reads (n,), within 0 .. 1.7.

    The chain starts settled at the first sample.
    """
    return _run(
        valve=valve_phi(path),
        dead_s=path.dead_time_s,
        mixing_s=path.mixing_s,
        rising_s=path.sensor_rising_s,
        falling_s=path.sensor_falling_s,
        gas_factor=path.gas_factor,
        span=path.span,
        period_s=period_s,
    )


def part(path: Path, rows: slice) -> Path:
    """Return the path of some consecutive samples."""
    return replace(path, **{f.name: getattr(path, f.name)[rows] for f in fields(path)})


def settled(fuel_mg: FloatArray, period_s: float, recovery_s: float = RECOVERY_S) -> BoolArray:
    """Return (n,) bool: fuel has been injected for longer than ``recovery_s``.

    >>> settled(np.array([9.0, 0.0, 9.0, 9.0, 9.0]), 0.1, recovery_s=0.2).tolist()
    [True, False, False, False, True]
    """
    cut = np.asarray(fuel_mg <= 0.0)
    at = np.arange(len(cut))
    last_cut = np.maximum.accumulate(np.where(cut, at, -1))
    return np.asarray((last_cut < 0) | (at - last_cut > round(recovery_s / period_s)))


@njit(cache=True)
def _weights(time: float) -> tuple[float, float]:  # pragma: no cover
    """Return the weights of the state and of the newest input in a lag of ``time`` samples.

    The last input has the remaining weight: the three add up to 1.
    """
    time = max(time, TIME_LEAST_S)
    keep = np.exp(-1.0 / time)
    return keep, 1.0 - time * (1.0 - keep)


@njit(cache=True)
def _valve_phi(
    factor: FloatArray, fuel_mg: FloatArray, air_mg: FloatArray
) -> FloatArray:  # pragma: no cover
    phi = np.empty(len(fuel_mg))
    for k in range(len(fuel_mg)):
        of_mixture = factor[k] * STOICHIOMETRIC * fuel_mg[k] / max(air_mg[k], AIR_LEAST_MG)
        phi[k] = min(max(of_mixture, 0.0), PHI_VALVE_MOST)
    return phi


@njit(cache=True)
def _run(
    valve: FloatArray,
    dead_s: FloatArray,
    mixing_s: FloatArray,
    rising_s: FloatArray,
    falling_s: FloatArray,
    gas_factor: FloatArray,
    span: FloatArray,
    period_s: float,
) -> FloatArray:  # pragma: no cover
    """Return the reading (n,)."""
    n = len(valve)
    reading = np.empty(n)
    if n == 0:
        return reading
    mix_s = sensor_s = np.nan  # time constants of the present weights of the two lags
    late_last = mixed = valve[0]
    pumped_last = read = 1.0 + span[0] * (mixed * gas_factor[0] - 1.0)
    for k in range(n):
        at = max(k - max(dead_s[k] / period_s, 0.0), 0.0)
        whole = int(at)
        late = valve[whole]
        if whole < k:
            late += (at - whole) * (valve[whole + 1] - valve[whole])
        if mixing_s[k] != mix_s:
            mix_s = mixing_s[k]
            keep, newest = _weights(mix_s / period_s)
        mixed = keep * mixed + newest * late + (1.0 - keep - newest) * late_last
        late_last = late
        pumped = 1.0 + span[k] * (mixed * gas_factor[k] - 1.0)
        time_s = rising_s[k] if pumped > read else falling_s[k]
        if time_s != sensor_s:
            sensor_s = time_s
            held, fresh = _weights(sensor_s / period_s)
        read = held * read + fresh * pumped + (1.0 - held - fresh) * pumped_last
        pumped_last = pumped
        read = min(max(read, 0.0), PHI_MAX)
        reading[k] = read
    return reading
