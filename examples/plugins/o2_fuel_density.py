"""An effect for o2train gap: warm fuel is less dense, so an injection of equal length holds less.

Equation and bounds stand here once; a fit computes them with numpy, a model file as ONNX nodes.
"""

from training.greybox.effects import Effect, Parameter

AT_DEGC = 80.0  # coolant at which the injector was calibrated


def density(at, values):
    """Return the fields of the path that change: the fuel that is injected."""
    (per_kelvin,) = values
    warmer = at.signal("coolant_temperature_degc") - AT_DEGC
    return {"fuel_mg": at.of("fuel_mg") * (1.0 - per_kelvin * warmer)}


EFFECT = Effect(
    name="fuel_density",
    says="the fuel becomes less dense as it warms up",
    parameters=(Parameter("expansion", "1/K", -0.002, 0.004, (0.001,), positive=True),),
    needs=("coolant_temperature_degc",),
    tag="physics",
    source="volume expansion of petrol, about 0.00095 1/K",
    equation=density,
)
