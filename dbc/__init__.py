"""CAN databases, with the signal maps beside them.

o2_ecu.dbc, o2_ecu.toml      the project's own engine ECU
o2_monitor.dbc               messages that the monitor sends
rusefi.dbc, rusefi.toml      rusEFI's verbose broadcast
wideband.dbc, wideband.toml  rusEFI's CAN wideband controller; aem_x.toml for the AEM X-series
obd2.dbc, obd2.toml          OBD-II PIDs, where a vehicle broadcasts no useful signals
"""

from importlib.resources import files
from pathlib import Path


def path(name: str) -> Path:
    """Return the path of a file of this package.

    name : file name, such as ``"o2_ecu.dbc"``
    Raises FileNotFoundError if there is no such file.

    >>> path("o2_ecu.dbc").name
    'o2_ecu.dbc'
    """
    file = Path(str(files("dbc"))) / name
    if not file.is_file():
        raise FileNotFoundError(f"no {name} among {', '.join(names())}")
    return file


def names() -> list[str]:
    """Return the names of the databases and maps in this package, sorted."""
    folder = Path(str(files("dbc")))
    return sorted(f.name for f in folder.iterdir() if f.suffix in {".dbc", ".toml"})
