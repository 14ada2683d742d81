"""Offline part: recordings, the simulated dynamometer, the NARX and its training.

The public names come from ``training.api`` and are imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from training.api.models import Evaluation, Fit, evaluate, fit
    from training.api.recordings import load_recordings
    from training.api.workflows import Gap, GapOptions, estimate_tables, find_gap

__all__ = [
    "Evaluation",
    "Fit",
    "Gap",
    "GapOptions",
    "estimate_tables",
    "evaluate",
    "find_gap",
    "fit",
    "load_recordings",
]


_PLACES: Final = {
    "Evaluation": "training.api.models",
    "Fit": "training.api.models",
    "Gap": "training.api.workflows",
    "GapOptions": "training.api.workflows",
    "estimate_tables": "training.api.workflows",
    "evaluate": "training.api.models",
    "find_gap": "training.api.workflows",
    "fit": "training.api.models",
    "load_recordings": "training.api.recordings",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return __all__
