"""python-can without its reader and writer of .mf4."""

import sys
from typing import Final

_MDF: Final = "asammdf"


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
