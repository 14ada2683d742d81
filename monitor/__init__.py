"""Streaming monitor for the upstream wideband oxygen sensor.

The rooms stand in the order of the data: base, frames, decode, grid, model, memory, judge,
pipeline, report, bus, inject, mapping, api, cli. ``pipeline`` joins them without I/O.

The public names come from ``monitor.api`` and are imported on first use, so that ``import
monitor`` is quick:

>>> from monitor import load_model
>>> load_model().card.kind
'narx'
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from monitor.api.listener import OxygenSensorMonitor
    from monitor.api.recordings import load_model, replay
    from monitor.api.stream import Monitor
    from monitor.api.verdict import Code, Verdict
    from monitor.base.errors import O2Error

__all__ = ["Code", "Monitor", "O2Error", "OxygenSensorMonitor", "Verdict", "load_model", "replay"]
__version__ = "0.1.0"

_PLACES: Final = {
    "Code": "monitor.api.verdict",
    "Monitor": "monitor.api.stream",
    "O2Error": "monitor.base.errors",
    "OxygenSensorMonitor": "monitor.api.listener",
    "Verdict": "monitor.api.verdict",
    "load_model": "monitor.api.recordings",
    "replay": "monitor.api.recordings",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return __all__
