"""The package's databases with their signal maps, loaded once; an ECU that sends by one."""

import numpy as np

import dbc
from monitor.base.types import FloatArray, Frame
from monitor.decode.bus_map import BusMap, load_pairs
from monitor.frames.blocks import frames_of
from training.recordings.files.can_log import broadcast


def _loaded(name: str, of: str = "") -> BusMap:
    return load_pairs([(dbc.path(f"{name}.dbc"), dbc.path(f"{of or name}.toml"))])


OWN, RUSEFI, OBD = map(_loaded, ("o2_ecu", "rusefi", "obd2"))
AEM = _loaded("wideband", "aem_x")


ECU_S = 2.0


def ecu(bus_map: BusMap = OWN, **changes: FloatArray | float) -> list[Frame]:
    """Return two seconds of an ECU, each message at its stated rate; NaN is not available.

    changes : values of signals, one or one for every 10 ms
    """
    t_ns = np.arange(0, round(ECU_S * 1e9), 10_000_000)
    usual = {"manifold_pressure_kpa": 50.0, "ambient_pressure_kpa": 98.0, "battery_voltage_v": 13.5}
    values = dict.fromkeys(bus_map.channels, 1.0) | usual | changes
    columns = {name: np.broadcast_to(value, len(t_ns)) for name, value in values.items()}
    return list(frames_of(broadcast(bus_map, t_ns, columns)))
