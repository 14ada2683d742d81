"""The package's databases with their signal maps, loaded once; an ECU that sends by one.

Its frames through the decoder, for tests that look at single frames.
"""

from collections.abc import Sequence

import numpy as np

import dbc
from monitor.base.types import FloatArray, Frame
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap, load_pairs
from monitor.frames.blocks import block_of, frames_of
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


Values = dict[str, float] | None  # of a frame by channel, None if it is not used


class Decoding:
    """A decoder, and what it makes of each frame."""

    def __init__(self, bus_map: BusMap, names: Sequence[str]) -> None:
        self.decoder = BlockDecoder(bus_map, names)

    def push(self, frames: Sequence[Frame]) -> list[Values]:
        """Return the values of each of some frames, which are one block."""
        found: list[Values] = [None] * len(frames)
        for part in self.decoder.push(block_of(list(frames))):
            assert sorted(set(part.rows.tolist())) == part.rows.tolist()
            names = [self.decoder.channels[channel] for channel in part.channels]
            for row, values in zip(part.rows.tolist(), part.values.T.tolist(), strict=True):
                found[row] = {**(found[row] or {}), **dict(zip(names, values, strict=True))}
        return found

    def one(self, frame: Frame) -> Values:
        """Return the values of one frame, a block of its own."""
        return self.push([frame])[0]


def values_of(bus_map: BusMap, name: str, frames: Sequence[Frame]) -> list[float]:
    """Return the values of one channel in the frames that are used."""
    found = Decoding(bus_map, [name]).push(frames)
    return [values[name] for values in found if values]
