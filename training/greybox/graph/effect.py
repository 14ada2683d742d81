"""An effect with its values as a part of a graph."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from training.greybox.effects.form.place import GraphPlace, PathNodes
from training.greybox.effects.model_effect import ModelEffect
from training.narx.export import Graph

FUEL = "fuel_mass_mg"  # every effect reads it


@dataclass(frozen=True, slots=True)
class GraphEffect:
    """An effect as nodes: it changes the mixture's path from inputs and its own states.

    add : (graph, path, signals, states) to the changed path and the next states; ``signals`` are
        the clipped inputs by name, ``states`` the names of ``n_states`` tensors, each (batch, 1)
    """

    name: str
    n_states: int
    add: Callable[
        [Graph, PathNodes, Mapping[str, str], Sequence[str]], tuple[PathNodes, Sequence[str]]
    ]
    dead_time_s: float = 0.0  # at most, beside the base's
    lag_s: float = 0.0  # time constants that a start must forget, at most, beside the base's
    slower: float = 0.0  # relative growth of the base's lags, at most


def graph_effect(effect: ModelEffect, period_s: float, reads: Collection[str]) -> GraphEffect:
    """Return the effect for a graph of this sample period.

    reads : the signals that it reads beside the fuel, see ``Effect.signals_of``; it sees no others
    """
    form, values = effect.effect, effect.values.tolist()

    def add(
        graph: Graph, path: PathNodes, signals: Mapping[str, str], states: Sequence[str]
    ) -> tuple[PathNodes, Sequence[str]]:
        seen = {name: signals[name] for name in (FUEL, *reads)}
        place = GraphPlace(graph, path, seen, states, period_s)
        changed = {name: value.name for name, value in form.equation(place, values).items()}
        return replace(path, **changed), place.kept

    return GraphEffect(
        effect.name,
        form.n_states,
        add,
        dead_time_s=form.dead_time_s(values),
        lag_s=form.lag_s(values),
        slower=form.slower(values),
    )


def effects_nodes(
    graph: Graph,
    effects: Sequence[GraphEffect],
    path: PathNodes,
    signals: Mapping[str, str],
    state: str,
    first: int,
) -> tuple[PathNodes, list[str]]:
    """Add effects to a path; return the changed path and the effects' next states.

    state : (batch, n); the effects' states stand in it from column ``first``
    """
    kept, at = list[str](), first
    for i, effect in enumerate(effects):
        own = graph.part(f"effect{i}_{effect.name}_")
        states = [own.take(state, at + j, at + j + 1, f"state{j}") for j in range(effect.n_states)]
        path, after = effect.add(own, path, signals, states)
        kept += after
        at += effect.n_states
    return path, kept
