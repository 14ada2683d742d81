"""The library's effects as nodes of the grey-box graph; tests hold them to their numpy forms."""

from collections.abc import Collection, Mapping, Sequence

from training.greybox.effects import LIBRARY
from training.greybox.effects.model_effect import Added
from training.greybox.effects.nodes import air, exhaust, fuel, sensor
from training.greybox.effects.nodes.form import Form
from training.greybox.effects.nodes.place import Place
from training.greybox.graph.nodes import GraphEffect, Nodes
from training.narx.export import Graph

FORMS: Mapping[str, Form] = fuel.FORMS | air.FORMS | exhaust.FORMS | sensor.FORMS
FUEL = "fuel_mass_mg"  # which every effect sees


def signals_of(name: str, present: Collection[str]) -> tuple[str, ...]:
    """Return the signals that an effect reads if those ``present`` are there, beside the chain's.

    >>> signals_of("purge", ["purge_duty_percent", "coolant_temperature_degc"])
    ('manifold_pressure_kpa', 'engine_speed_rpm', 'purge_duty_percent')
    """
    form = FORMS[name]
    optional = (n for n in form.optional if n in present and form.unless.get(n) not in present)
    return (*LIBRARY[name].needs, *optional)


def graph_effect(added: Added, period_s: float, reads: Collection[str]) -> GraphEffect:
    """Return the effect for a graph of this sample period.

    reads : see ``signals_of``; beside these and the fuel the effect sees no input of the graph
    """
    form, p = FORMS[added.name], added.values.tolist()

    def add(
        graph: Graph, nodes: Nodes, signals: Mapping[str, str], states: Sequence[str]
    ) -> tuple[Nodes, Sequence[str]]:
        seen = {name: signals[name] for name in (FUEL, *reads)}
        place = Place(graph, nodes, seen, states, period_s)
        return form.add(place, p), place.kept

    return GraphEffect(
        added.name, form.n_states, add, form.dead_time_s(p), form.lag_s(p), form.slower(p)
    )
