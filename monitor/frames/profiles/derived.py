"""Signals that a logger does not have but others give: charge, fuel, controller, fuel cut.

Fuel per stroke = flow * (pulse width - dead time); a grey-box model's gain takes up an error of the
profile's ``[engine]``. Air per stroke is never made of the ECU's volumetric efficiency: the pulse
width is made of it, too, so the two would agree whatever the engine breathes. A grey-box model
learns the efficiency from pressure, temperature and speed instead.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from monitor.base.types import FloatArray
from monitor.frames.profiles.profile import ProfileEngine

VOLTAGE_RATED_V: Final = 14.0
SPEED_LEAST_RPM: Final = 50.0  # below it the engine stands, and a mass per stroke means nothing

Signals = Mapping[str, FloatArray]

_PRESSURE: Final = "manifold_pressure_kpa"
_PULSE: Final = "injector_pulse_width_ms"
_RPM: Final = "engine_speed_rpm"
_TRIM: Final = "lambda_correction_percent"
_CONTROLLER: Final = "lambda_controller"


class Derivation(NamedTuple):
    """A way to a signal: its sources, which must all be there, and the formula."""

    name: str
    sources: tuple[str, ...]
    formula: Callable[[Signals, ProfileEngine], FloatArray]
    in_words: str


def _no_fuel(s: Signals, engine: ProfileEngine) -> FloatArray:
    """Return 1 while the injectors stay shut at speed; without a pulse width in an overrun.

    A pulse width above 0 says that fuel comes, whatever the pressure.
    """
    if _PULSE in s:
        told, cut = s[_PULSE], (s[_RPM] > SPEED_LEAST_RPM) & (s[_PULSE] <= 0.0)
    elif _PRESSURE in s and engine.overrun_below_kpa > 0.0:
        told, is_fast = s[_PRESSURE], s[_RPM] > engine.overrun_above_rpm
        cut = is_fast & (told < engine.overrun_below_kpa)
    else:
        return np.full(len(s[_RPM]), np.nan)
    return np.where(np.isfinite(told), cut, np.nan)


def _air_of_meter(s: Signals, engine: ProfileEngine) -> FloatArray:
    speed = np.where(s[_RPM] > SPEED_LEAST_RPM, s[_RPM], np.nan)
    return s["maf_kg_h"] * 1e6 / 60.0 / (speed * engine.cylinders / 2.0)


def _air_of_load(s: Signals, engine: ProfileEngine) -> FloatArray:
    return s["load_g_per_rev"] * 1000.0 * 2.0 / engine.cylinders


def _fuel_of_pulse(s: Signals, engine: ProfileEngine) -> FloatArray:
    dead_ms = np.full(len(s["injector_pulse_width_ms"]), engine.injector_dead_time_ms)
    if "battery_voltage_v" in s:
        below_v = VOLTAGE_RATED_V - s["battery_voltage_v"]
        slope = engine.injector_dead_time_ms_per_v
        dead_ms = dead_ms + slope * np.where(np.isfinite(below_v), below_v, 0.0)
    open_ms = np.maximum(s["injector_pulse_width_ms"] - dead_ms, 0.0)
    return np.asarray(engine.injector_mg_per_ms * open_ms)


# in the order of preference; a signal that a column carries is never derived
DERIVATIONS: Final = (
    Derivation(
        _CONTROLLER, (_TRIM,), lambda s, _: 1.0 + s[_TRIM] / 100.0, "the correction in percent"
    ),
    Derivation(
        _TRIM,
        (_CONTROLLER,),
        lambda s, _: 100.0 * (s[_CONTROLLER] - 1.0),
        "the controller's factor",
    ),
    Derivation("fuel_cut", (_RPM,), _no_fuel, "a pulse width of 0, or low pressure at speed"),
    Derivation("air_mass_mg", ("maf_kg_h", _RPM), _air_of_meter, "air flow and speed"),
    Derivation("air_mass_mg", ("load_g_per_rev",), _air_of_load, "the load in g per revolution"),
    Derivation("fuel_mass_mg", (_PULSE,), _fuel_of_pulse, "pulse width less dead time"),
)


def derive(signals: Signals, engine: ProfileEngine) -> Iterator[tuple[Derivation, FloatArray]]:
    """Yield the signals that can be derived and are not there; (n,) each, NaN where unknown."""
    there = dict(signals)
    for each in DERIVATIONS:
        if each.name in there or not all(name in there for name in each.sources):
            continue
        with np.errstate(all="ignore"):
            values = np.asarray(each.formula(there, engine), dtype=np.float64)
        if np.isfinite(values).any():
            there[each.name] = values
            yield each, values
