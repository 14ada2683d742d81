"""The description of the server read by odxtools, and requests for all that it describes."""

import io
import random
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from odxtools.database import Database

from monitor.base.types import Sample
from monitor.bus.diagnostics.parameters import PARAMETERS
from monitor.bus.odx.description import pdx
from monitor.memory.codes import CODES, every
from monitor.memory.obd_records import FreezeFrame
from monitor.pipeline.events import Tick
from tests.helpers.diagnostics_state import Vehicle

SIGNALS = tuple(dict.fromkeys(p.signal for p in PARAMETERS.values()))


def read() -> Any:
    """Return the diagnostic layer of the description."""
    database = Database()
    database.add_pdx_file(io.BytesIO(pdx()))
    database.refresh()
    (layer,) = database.diag_layers
    return layer


def requests(layer: Any, draw: random.Random) -> Iterator[bytes]:
    """Yield a request for every service of the layer; its values are drawn."""
    for service in layer.services:
        values: dict[str, Any] = {}
        for parameter in service.request.parameters:
            if parameter.parameter_type != "VALUE":
                continue
            values[parameter.short_name] = _value(parameter, draw)
        yield bytes(service.request.encode(**values))


def _value(parameter: Any, draw: random.Random) -> Any:
    match parameter.short_name:
        case "dtc":
            return draw.choice(every())
        case "group":
            return draw.choice((0x33, 0x33, 0xFFFFFF & 0xFE))
        case "number":
            return draw.choice((0x00, 0x01, 0x03, 0x05, 0x91, 0xF0, 0xFE, 0xFF))
        case "readiness_group":
            return draw.choice((1, 3, 6, 7))
        case "key":
            return draw.randbytes(8)
    return draw.randrange(256)


def drawn_vehicle(draw: random.Random) -> Vehicle:
    """Return a monitor in a state of its own: signals, codes, freeze frames."""
    vehicle = Vehicle(draw.uniform(0.0, 6000.0), vin=draw.choice((None, "WVWZZZ1JZXW386759")))
    state, store = vehicle.state, vehicle.store
    state.is_obd_on_uds = draw.random() < 0.5
    state.names = SIGNALS
    values = np.array([draw.uniform(0.0, 1.2) for _ in SIGNALS])
    values[np.array([draw.random() < 0.2 for _ in SIGNALS])] = np.nan
    sample = Sample(0, 0, values, np.zeros(len(SIGNALS), dtype=np.uint8))
    state.push(Tick(sample, draw.uniform(0.7, 1.3), (True, False, True), False))
    for fault in draw.sample(sorted(CODES), 4):
        for dtc in store.fail(fault, 7):
            for t_ns in (7, 8):
                names = draw.sample(SIGNALS, 5)
                frame = {name: draw.uniform(0.0, 90.0) for name in names}
                store.freeze(FreezeFrame(dtc.code, t_ns, frame))
    state.prefailed = lambda: {"P0133": 64}
    return vehicle


def single(value: float) -> float:
    """Return a number as four bytes hold it."""
    return float(struct.unpack(">f", struct.pack(">f", value))[0])
