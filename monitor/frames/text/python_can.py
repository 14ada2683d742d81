"""python-can without its reader and writer of .mf4, imported where a bus or a new log needs it."""

import sys
from types import ModuleType
from typing import Final

_MDF: Final = "asammdf"
_TESTER: Final = "cantools.tester"


def import_without_mdf() -> None:
    """Import python-can as where asammdf is not installed; later imports of asammdf work.

    ``import can`` imports asammdf where it finds it, and with it pandas, polars and sympy: 1.3 s
    and 120 MB. Only python-can's own reader and writer of .mf4 need it. ``monitor.frames.mdf``
    reads .mf4 without them, so a command that writes no log can do without. None in
    ``sys.modules`` makes an import fail with ModuleNotFoundError (Python's import system, "The
    module cache"); python-can treats asammdf as optional.
    """
    if "can" in sys.modules or _MDF in sys.modules:
        return
    sys.modules[_MDF] = None  # type: ignore[assignment]
    try:
        import can  # noqa: F401, PLC0415
    finally:
        del sys.modules[_MDF]


def import_cantools_alone() -> None:
    """Import cantools without its tester, the only part of it that imports python-can.

    python-can, and with it asyncio, takes 0.1 s: as long as numpy, and a sixth of the time of a
    short replay. A later import of the tester works.
    """
    if "cantools" in sys.modules or "can" in sys.modules:
        return
    sys.modules[_TESTER] = ModuleType(_TESTER)
    try:
        import cantools  # noqa: F401, PLC0415
    finally:
        del sys.modules[_TESTER]
