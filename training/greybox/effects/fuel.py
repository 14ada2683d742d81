"""Effects on the fuel that reaches the cylinder."""

from dataclasses import replace

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import STOICHIOMETRIC, Path
from training.greybox.effects.dynamics import lag
from training.greybox.effects.effect import Effect, Parameter, Signals, ambient_kpa, injecting

REFERENCE_RAIL_MPA = 10.0
WARM_DEGC = 80.0
VAPOUR_LAG_S = 1.0  # canister line and intake
ETHANOL_AIR_FUEL = 9.0  # stoichiometric, by mass
GAIN_OF_ETHANOL = 1.0 - ETHANOL_AIR_FUEL / STOICHIOMETRIC  # of the mixture, per fraction


def _wall_film(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Part of the fuel lands on walls and evaporates later: the X-tau model.

    The film takes a share X of the fuel flow and gives it back with the time constant tau; both
    grow by ``cold_growth`` per 60 K below a warm engine.
    Source: Aquino, SAE 810494.
    """
    share, time_s, cold_growth = p
    coolant = signals.get("coolant_temperature_degc")
    cold = 0.0 if coolant is None else np.maximum(WARM_DEGC - coolant, 0.0) / 60.0
    grown = 1.0 + cold_growth * cold
    strokes_per_s = np.maximum(signals["engine_speed_rpm"], 400.0) / 30.0
    landed = np.minimum(share * grown, 0.8) * path.fuel_mg
    evaporated = lag(landed * strokes_per_s, time_s * grown, period_s) / strokes_per_s
    return replace(path, fuel_mg=path.fuel_mg - landed + evaporated)


def _injector_offset(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Every injection gives a constant mass more than commanded: a wrong dead time.

    It matters most where injections are short.
    """
    return replace(path, fuel_mg=np.maximum(path.fuel_mg + p[0] * injecting(signals), 0.0))


def _rail_exponent(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Injected mass follows rail pressure by another power than the ECU's square root.

    The deviation x makes a factor (p / 10 MPa)**x. Source: Bernoulli, with cavitation.
    """
    ratio = np.maximum(signals["rail_pressure_mpa"], 0.5) / REFERENCE_RAIL_MPA
    return replace(path, fuel_mg=path.fuel_mg * ratio ** p[0])


def _purge(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Fuel vapour of the canister comes with the purge air.

    Vapour flow is the concentration times valve duty times the pressure drop to the manifold,
    smoothed by the line. Without a duty signal the valve is taken as open when the engine is warm,
    driving and throttled.
    """
    drop_kpa = np.maximum(ambient_kpa(signals) - signals["manifold_pressure_kpa"], 0.0)
    duty = signals.get("purge_duty_percent")
    if duty is None:
        duty = 50.0 * _purge_allowed(path, signals)
    strokes_per_s = np.maximum(signals["engine_speed_rpm"], 400.0) / 30.0
    vapour_mg_s = lag(p[0] * 0.01 * duty * drop_kpa, VAPOUR_LAG_S, period_s)
    more = vapour_mg_s / strokes_per_s * injecting(signals)
    return replace(path, fuel_mg=path.fuel_mg + more)


def _purge_allowed(path: Path, signals: Signals) -> FloatArray:
    warm = signals.get("coolant_temperature_degc", np.full_like(path.fuel_mg, WARM_DEGC)) > 60.0
    driving = signals["engine_speed_rpm"] > 1000.0
    return (warm & driving & injecting(signals)).astype(np.float64)


def _ethanol(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Fuel with a fraction of ethanol needs less air: the stoichiometric ratio falls."""
    return replace(path, factor=path.factor * (1.0 - p[0] * GAIN_OF_ETHANOL))


EFFECTS = (
    Effect(
        "wall_film",
        "part of the fuel lands on walls and evaporates later",
        (
            Parameter("share", "-", -0.1, 0.6, (0.1,), positive=True),
            Parameter("time", "s", 0.1, 4.0, (0.4, 1.2)),
            Parameter("cold_growth", "-", 0.0, 4.0, (1.0,), spread=1.0),
        ),
        _wall_film,
        ("engine_speed_rpm",),
        "physics",
    ),
    Effect(
        "injector_offset",
        "every injection gives a constant mass more or less",
        (Parameter("offset", "mg/stroke", -3.0, 3.0, (0.1,)),),
        _injector_offset,
        (),
        "either",
    ),
    Effect(
        "rail_exponent",
        "injected mass follows rail pressure by another power",
        (Parameter("exponent", "-", -0.5, 0.5, (0.05,)),),
        _rail_exponent,
        ("rail_pressure_mpa",),
        "physics",
    ),
    Effect(
        "purge",
        "canister purge brings fuel vapour",
        (Parameter("concentration", "mg/s/kPa", -2.0, 8.0, (0.3,), positive=True),),
        _purge,
        ("manifold_pressure_kpa", "engine_speed_rpm"),
        "physics",
        varies=True,
    ),
    Effect(
        "ethanol",
        "the fuel's stoichiometric ratio differs",
        (Parameter("fraction", "-", -0.3, 1.0, (0.05,)),),
        _ethanol,
        (),
        "either",
        ("humidity", "slope error of the air meter", "slope error of the injectors"),
        gain_class=True,
    ),
)
