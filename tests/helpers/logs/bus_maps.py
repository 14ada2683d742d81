"""The package's databases with their signal maps, loaded once."""

import dbc
from monitor.decode.bus_map import BusMap, load_pairs


def _loaded(name: str, of: str = "") -> BusMap:
    return load_pairs([(dbc.path(f"{name}.dbc"), dbc.path(f"{of or name}.toml"))])


OWN, RUSEFI, OBD = map(_loaded, ("o2_ecu", "rusefi", "obd2"))
AEM = _loaded("wideband", "aem_x")
