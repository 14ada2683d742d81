"""Effects on the fuel that the cylinder gets."""

from functools import partial
from typing import Final

from training.greybox.chain import STOICHIOMETRIC
from training.greybox.effects.effect import Changed, Effect, Parameter, Place, Values
from training.greybox.quantity.value import maximum, minimum, where

FILM_WARM_DEGC: Final = 80.0
FILM_SHARE_MAX: Final = 0.8
REFERENCE_RAIL_MPA: Final = 10.0
RAIL_MIN_MPA: Final = 0.5
VAPOUR_LAG_S: Final = 1.0  # canister line and intake
PURGE_WARM_DEGC: Final = 60.0
PURGE_RPM: Final = 1000.0
PURGE_PERCENT: Final = 50.0  # duty of the valve while it is taken to be open
ETHANOL_AIR_FUEL: Final = 9.0  # stoichiometric, by mass
GAIN_OF_ETHANOL: Final = 1.0 - ETHANOL_AIR_FUEL / STOICHIOMETRIC  # of the mixture, per fraction


@partial(
    Effect,
    says="part of the fuel lands on walls and evaporates later",
    look_at="a transient compensation of the ECU that is too strong",
    parameters=(
        Parameter("share", "-", -0.1, 0.6, (0.1,), positive=True),
        Parameter("time", "s", 0.1, 4.0, (0.4, 1.2)),
        Parameter("cold_growth", "-", 0.0, 4.0, (1.0,), spread=1.0),
    ),
    needs=("engine_speed_rpm",),
    optional=("coolant_temperature_degc",),
    tag="physics",
)
def wall_film(at: Place, p: Values) -> Changed:
    """Let a film take a share X of the fuel flow and give it back with the time constant tau.

    Both grow by ``cold_growth`` per 60 K below a warm engine. Source: Aquino, SAE 810494.
    """
    share, time_s, cold_growth = p
    coolant = at.signals.get("coolant_temperature_degc", FILM_WARM_DEGC)
    grown = 1.0 + cold_growth * (maximum(FILM_WARM_DEGC - coolant, 0.0) / 60.0)
    fuel, strokes = at.of("fuel_mg"), at.strokes_per_s()
    landed = fuel * minimum(share * grown, FILM_SHARE_MAX)
    evaporated = at.lag(landed * strokes, time_s * grown) / strokes
    return {"fuel_mg": fuel - landed + evaporated}


@partial(
    Effect,
    says="every injection gives a constant mass more or less",
    parameters=(Parameter("offset", "mg/stroke", -3.0, 3.0, (0.1,)),),
    tag="either",
)
def injector_offset(at: Place, p: Values) -> Changed:
    """A wrong dead time of the injectors does this; it matters most where injections are short."""
    fuel = at.of("fuel_mg")
    return {"fuel_mg": maximum(fuel + where(at.injecting(), p[0], 0.0), 0.0)}


@partial(
    Effect,
    says="injected mass follows rail pressure by another power",
    parameters=(Parameter("exponent", "-", -0.5, 0.5, (0.05,)),),
    needs=("rail_pressure_mpa",),
    tag="physics",
)
def rail_exponent(at: Place, p: Values) -> Changed:
    """Multiply the fuel by (p / 10 MPa)**x: cavitation adds x to the power 1/2 of Bernoulli."""
    ratio = maximum(at.signal("rail_pressure_mpa"), RAIL_MIN_MPA) / REFERENCE_RAIL_MPA
    return {"fuel_mg": at.of("fuel_mg") * ratio ** p[0]}


@partial(
    Effect,
    says="canister purge brings fuel vapour",
    look_at="air through the purge valve: an empty canister whose vapour the ECU takes for granted",
    parameters=(Parameter("concentration", "mg/s/kPa", -2.0, 8.0, (0.3,), positive=True),),
    needs=("manifold_pressure_kpa", "engine_speed_rpm"),
    optional=("ambient_pressure_kpa", "purge_duty_percent", "coolant_temperature_degc"),
    superseded=(("coolant_temperature_degc", "purge_duty_percent"),),
    tag="physics",
    varies=True,
)
def purge(at: Place, p: Values) -> Changed:
    """Add concentration times duty times pressure drop, behind the lag of line and intake.

    Without a duty signal the valve is taken to be half open while the engine is warm and driving.
    """
    fuel = at.of("fuel_mg")
    drop_kpa = maximum(at.ambient_kpa() - at.signal("manifold_pressure_kpa"), 0.0)
    if "purge_duty_percent" in at.signals:
        duty = at.signal("purge_duty_percent")
    else:
        allowed = (at.signal("engine_speed_rpm") > PURGE_RPM) & at.injecting()
        if "coolant_temperature_degc" in at.signals:
            allowed = allowed & (at.signal("coolant_temperature_degc") > PURGE_WARM_DEGC)
        duty = where(allowed, PURGE_PERCENT, 0.0)
    vapour_mg_s = at.lag(p[0] * 0.01 * duty * drop_kpa, VAPOUR_LAG_S)
    return {"fuel_mg": fuel + where(at.injecting(), vapour_mg_s / at.strokes_per_s(), 0.0)}


@partial(
    Effect,
    says="the fuel's stoichiometric ratio differs",
    parameters=(Parameter("fraction", "-", -0.3, 1.0, (0.05,)),),
    tag="either",
    like=("biased", "humidity", "slope error of the air meter", "slope error of the injectors"),
    gain_class=True,
)
def ethanol(at: Place, p: Values) -> Changed:
    """The stoichiometric ratio falls from 14.7 to 9.0 by mass in proportion to the fraction."""
    return {"factor": at.of("factor") * (1.0 - p[0] * GAIN_OF_ETHANOL)}
