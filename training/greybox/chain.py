"""The grey-box chain, once for arrays and graphs: charge and fuel, transport, mixing, sensor.

phi at the valve is stoichiometric ratio · fuel / air · factor. It travels for a dead time and is
mixed by a first-order lag. The sensor pumps 1 + span · (gas - 1) of the mixed gas and reads it
behind a second lag, whose time constant may differ by direction. All values are in phi = 1/lambda,
which is 0 in fuel cut.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from training.greybox.quantity.dynamics import delayed, ramp_lag, sensor_lag
from training.greybox.quantity.value import Quantity, clip, maximum

STOICHIOMETRIC = 14.7  # air over fuel by mass; for another fuel the gain differs
AIR_LEAST_MG = 5.0  # per stroke; below it the engine stands
SPEED_LEAST_RPM, SPEED_MOST_RPM = 300.0, 9000.0
PHI_VALVE_MOST = 3.0
CYLINDERS = 4  # between air meter, charge and engine speed; for another number constants differ
KG_H_PER_MG_RPM = 60.0e-6 / 2.0  # of one cylinder, four strokes
MG_RPM_PER_KG_H = 1.0 / (KG_H_PER_MG_RPM * CYLINDERS)
RECOVERY_S = 2.0  # after fuel cut, until transport, mixing and sensor have passed on phi = 0


class Constants(NamedTuple):
    """The chain's calibration constants, which a fit may move."""

    gain: float = 1.0
    dead_time_s: float = 0.15
    dead_time_revolutions: float = 1.5  # 90 / rpm seconds
    mixing_s: float = 0.06  # at most sensor_s: the two lags read the same in either order
    sensor_s: float = 0.10
    span: float = 1.0


class ConstantRange(NamedTuple):
    """Unit, bounds and meaning of one constant."""

    unit: str
    low: float
    high: float
    meaning: str


RANGES: Mapping[str, ConstantRange] = {
    "gain": ConstantRange("-", 0.4, 2.5, "of fuel over air: injector, air meter and fuel in one"),
    "dead_time_s": ConstantRange("s", 0.0, 1.0, "part that does not follow engine speed"),
    "dead_time_revolutions": ConstantRange("rev", 0.0, 6.0, "part that follows engine speed"),
    "mixing_s": ConstantRange("s", 0.005, 1.5, "first lag, the shorter one: mixing in the exhaust"),
    "sensor_s": ConstantRange("s", 0.005, 1.5, "second lag: the sensor"),
    "span": ConstantRange("-", 0.3, 2.0, "sensitivity of the sensor about lambda 1"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Path:
    """The mixture's way from valve to sensor, each field (n,) at the sample period or a number."""

    fuel_mg: Quantity  # per stroke, into the cylinder
    air_mg: Quantity  # per stroke
    factor: Quantity  # on phi at the valve; the base's gain
    dead_time_s: Quantity
    mixing_s: Quantity
    sensor_rising_s: Quantity  # rising phi is lean to rich
    sensor_falling_s: Quantity
    gas_factor: Quantity = 1.0  # on phi at the sensor, after mixing
    span: Quantity = 1.0


def charge_mg(signals: Mapping[str, Quantity]) -> Quantity:
    """Return the air per stroke (n,) in mg, as broadcast or from air meter and engine speed."""
    if "air_mass_mg" in signals:
        return signals["air_mass_mg"]
    rpm = maximum(signals["engine_speed_rpm"], SPEED_LEAST_RPM)
    return signals["maf_kg_h"] * MG_RPM_PER_KG_H / rpm


def with_speed(signals: Mapping[str, Quantity]) -> dict[str, Quantity]:
    """Return the signals with engine speed (n,), as broadcast or from air meter and charge."""
    complete = dict(signals)
    if "engine_speed_rpm" not in complete:
        air_mg = maximum(signals["air_mass_mg"], AIR_LEAST_MG)
        rpm = signals["maf_kg_h"] * MG_RPM_PER_KG_H / air_mg
        complete["engine_speed_rpm"] = clip(rpm, SPEED_LEAST_RPM, SPEED_MOST_RPM)
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


def base_path(constants: Constants, signals: Mapping[str, Quantity]) -> Path:
    """Return the path without effects for the signals (n,) of ``inputs_of``."""
    rpm = maximum(signals["engine_speed_rpm"], SPEED_LEAST_RPM)
    return Path(
        fuel_mg=signals["fuel_mass_mg"],
        air_mg=charge_mg(signals),
        factor=constants.gain,
        dead_time_s=constants.dead_time_s + 60.0 * constants.dead_time_revolutions / rpm,
        mixing_s=constants.mixing_s,
        sensor_rising_s=constants.sensor_s,
        sensor_falling_s=constants.sensor_s,
        span=constants.span,
    )


def valve_phi(path: Path) -> Quantity:
    """Return phi at the valve (n,), within 0 .. 3."""
    per_mg = path.factor * STOICHIOMETRIC / maximum(path.air_mg, AIR_LEAST_MG)
    return clip(per_mg * path.fuel_mg, 0.0, PHI_VALVE_MOST)


def simulate(path: Path, period_s: float, *, smooth: bool = False) -> Quantity:
    """Return the phi that the sensor reads (n,), within 0 .. 1.7.

    smooth : the mixture runs along a cubic between samples instead of straight, see ``delayed``
    The chain starts settled at the first sample.
    """
    late = delayed(valve_phi(path), path.dead_time_s / period_s, smooth=smooth)
    mixed = ramp_lag(late, path.mixing_s, period_s)
    pumped = (1.0 - path.span) + (path.span * path.gas_factor) * mixed
    return sensor_lag(pumped, path.sensor_rising_s, path.sensor_falling_s, period_s)
