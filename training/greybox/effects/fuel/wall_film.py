"""Wall film: part of the fuel lands on the intake's walls and evaporates later, the X-tau model.

The film takes a share X of the fuel flow and gives it back with the time constant tau. Both grow
by ``cold_growth`` per 60 K below a warm engine.
Source: Aquino, Transient A/F control characteristics of the 5 liter central fuel injection engine,
SAE 810494.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, maximum, minimum

WARM_DEGC: Final = 80.0
SHARE_MAX: Final = 0.8


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    share, time_s, cold_growth = p
    fuel, grown = at.of("fuel_mg"), None
    if "coolant_temperature_degc" in at.signals:
        cold = maximum(WARM_DEGC - at.signal("coolant_temperature_degc"), 0.0) / 60.0
        grown = 1.0 + cold_growth * cold
    strokes = at.strokes_per_s()
    landed = fuel * (min(share, SHARE_MAX) if grown is None else minimum(share * grown, SHARE_MAX))
    lag_s = time_s if grown is None else time_s * grown
    evaporated = at.lag(landed * strokes, lag_s) / strokes
    return {"fuel_mg": fuel - landed + evaporated}


EFFECT: Final = Effect(
    name="wall_film",
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
    equation=_equation,
)
