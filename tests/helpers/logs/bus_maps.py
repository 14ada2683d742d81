"""The package's databases with their signal maps, loaded once."""

import dbc
from monitor.decode.bus_map import load_pairs

OWN, RUSEFI, OBD = (
    load_pairs([(dbc.path(f"{name}.dbc"), dbc.path(f"{name}.toml"))])
    for name in ("o2_ecu", "rusefi", "obd2")
)
