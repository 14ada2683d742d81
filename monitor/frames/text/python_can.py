"""python-can and cantools without parts that take long to import and are rarely needed."""

import sys
from importlib import import_module
from types import ModuleType


def import_without_mdf() -> None:
    """Import python-can as where asammdf is not installed; later imports of asammdf work.

    ``import can`` imports asammdf where it finds it, and with it pandas, polars and sympy: 1.3 s
    and 120 MB. Only python-can's own reader and writer of .mf4 need it. ``monitor.frames.mdf``
    reads .mf4 without them, so a command that writes no log can do without. None in
    ``sys.modules`` makes an import fail with ModuleNotFoundError (Python's import system, "The
    module cache"); python-can treats asammdf as optional.
    """
    _import("can", "asammdf", None)


def import_cantools_alone() -> None:
    """Import cantools without its tester, the only part of it that imports python-can.

    python-can, and with it asyncio, takes 0.1 s: as long as numpy, and a sixth of the time of a
    short replay. A later import of the tester works.
    """
    if "can" not in sys.modules:
        _import("cantools", "cantools.tester", ModuleType("cantools.tester"))


def _import(name: str, part: str, stand_in: ModuleType | None) -> None:
    if name in sys.modules or part in sys.modules:
        return
    sys.modules[part] = stand_in  # type: ignore[assignment]
    try:
        import_module(name)
    finally:
        del sys.modules[part]
