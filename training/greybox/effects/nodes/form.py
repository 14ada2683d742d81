"""What an effect is in a graph."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from training.greybox.effects.nodes.place import Place
from training.greybox.graph.nodes import Nodes

Parameters = Sequence[float]


def _none(p: Parameters) -> float:
    return 0.0


@dataclass(frozen=True, slots=True)
class Form:
    """The nodes of one effect of the library and what they need."""

    add: Callable[[Place, Parameters], Nodes]
    n_states: int = 0
    optional: tuple[str, ...] = ()  # signals that it reads if they are there
    unless: Mapping[str, str] = field(default_factory=dict)  # optional signal → a better one
    dead_time_s: Callable[[Parameters], float] = _none  # at most, beside the base's
    lag_s: Callable[[Parameters], float] = _none  # at most, beside the base's lags
    slower: Callable[[Parameters], float] = _none  # relative growth of the base's lags, at most
