"""Signals that a model's monitor needs, and those that it looks at."""

from collections.abc import Collection, Sequence

from monitor.base.errors import MissingSignalsError
from monitor.judge import enable
from monitor.judge.catalyst.watch import REAR
from monitor.judge.catalyst.watch import SIGNALS as CATALYST_SIGNALS
from monitor.judge.electrical.plausibility import DUTY
from monitor.memory.cycles import SIGNALS as CYCLE_SIGNALS
from monitor.model.card import ModelCard


def check_names(card: ModelCard, names: Sequence[str]) -> None:
    """Raise RecordingError if a signal that the model needs is not among ``names``."""
    lacking = lacking_names(card, names)
    if lacking:
        raise MissingSignalsError(needs(lacking, names))


def lacking_names(card: ModelCard, names: Sequence[str]) -> list[str]:
    """Return the signals that the model needs and that are not among ``names``."""
    return [name for name in (*card.input_names, card.output.name) if name not in names]


def needs(lacking: Sequence[str], names: Sequence[str]) -> str:
    """Return in words which signals lack and which are there."""
    return f"the model needs {', '.join(lacking)}; there are {', '.join(names) or 'none'}"


def needed_names(card: ModelCard, available: Collection[str]) -> tuple[str, ...]:
    """Return which of the available signals the monitor looks at, in its order."""
    wanted = (*card.input_names, card.output.name, *enable.SIGNALS, *CYCLE_SIGNALS, DUTY)
    if any(name in available for name in REAR):
        wanted = (*wanted, *CATALYST_SIGNALS)
    return tuple(name for name in dict.fromkeys(wanted) if name in available)
