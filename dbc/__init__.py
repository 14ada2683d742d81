"""CAN databases and the signal maps that lie beside them.

o2_ecu.dbc, o2_ecu.toml      the project's own engine ECU
o2_monitor.dbc               what the monitor itself sends
rusefi.dbc, rusefi.toml      rusEFI's verbose broadcast
wideband.dbc, wideband.toml  rusEFI's CAN wideband controller; aem_x.toml for the AEM X-series
obd2.dbc, obd2.toml          OBD-II PIDs, the fallback
"""

from importlib.resources import files
from pathlib import Path


def path(name: str) -> Path:
    """Return the path of one of this package's files.

    name : file name, such as ``"o2_ecu.dbc"``
    Raises FileNotFoundError if there is no such file.

    >>> path("o2_ecu.dbc").name
    'o2_ecu.dbc'
    """
    found = Path(str(files("dbc"))) / name
    if not found.is_file():
        raise FileNotFoundError(f"no {name} among {', '.join(names())}")
    return found


def names() -> list[str]:
    """Return the names of the databases and maps in this package, sorted."""
    folder = Path(str(files("dbc")))
    return sorted(f.name for f in folder.iterdir() if f.suffix in {".dbc", ".toml"})
