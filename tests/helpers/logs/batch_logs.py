"""Random logs of the project's own ECU, in which everything happens that logs are spoilt by."""

from collections.abc import Callable
from typing import Final

import numpy as np
from hypothesis import strategies as st

from monitor.base.types import Frame
from monitor.decode.checksum import payload_checksum
from monitor.frames.loop_frames import bus_state, codes_cleared, time_mark
from tests.helpers.logs.bus_maps import OWN as ECU

MS: Final = 1_000_000
S: Final = 1_000 * MS
MESSAGES: Final = {c.message.frame_id: c.message for c in ECU.channels.values()}
USUAL: Final = {
    "air_mass_mg": 300.0,
    "maf_kg_h": 36.0,
    "manifold_pressure_kpa": 45.0,
    "fuel_mass_mg": 20.0,
    "rail_pressure_mpa": 10.0,
    "lambda_controller": 1.0,
    "lambda_measured": 1.0,
    "lambda_target": 1.0,
    "closed_loop": 1.0,
    "fuel_cut": 0.0,
    "sensor_ready": 1.0,
    "engine_speed_rpm": 2000.0,
    "engine_torque_nm": 50.0,
    "throttle_percent": 20.0,
    "vehicle_speed_km_h": 60.0,
    "manifold_temperature_degc": 30.0,
    "coolant_temperature_degc": 85.0,
    "ambient_temperature_degc": 20.0,
    "ambient_pressure_kpa": 100.0,
    "battery_voltage_v": 12.5,
    "purge_duty_percent": 20.0,
    "sensor_heater_percent": 40.0,
}
CYCLE_NS: Final = {
    c.message.frame_id: c.message.cycle_time * MS for n, c in ECU.channels.items() if n in USUAL
}


def payload(can_id: int, values: dict[str, float], count: int) -> bytes:
    """Return a sound payload of the project's own ECU."""
    sent = {
        c.signal.name: values[n] for n, c in ECU.channels.items() if c.message.frame_id == can_id
    }
    fields = {**sent, "AliveCounter": count % 16, "Checksum": 0}
    raw = bytearray(MESSAGES[can_id].encode(fields, strict=False))
    raw[7] = payload_checksum("crc8_sae_j1850_id", can_id, raw, 7)
    return bytes(raw)


_SENT: dict[tuple[int, int, int], bytes] = {}


def _usual(can_id: int, level: int, count: int) -> bytes:
    """Return a sound payload at one of several operating points; encoding is slow."""
    key = can_id, level, count % 16
    if key not in _SENT:
        moved = {name: value * (1.0 + 0.02 * level) for name, value in USUAL.items()}
        moved |= {name: USUAL[name] for name in ("closed_loop", "fuel_cut", "sensor_ready")}
        _SENT[key] = payload(can_id, moved, count)
    return _SENT[key]


@st.composite
def logs(draw: st.DrawFn) -> list[Frame]:
    """Return the frames of up to some seconds of driving to which some of EVENTS happen."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    t0_ns = draw(st.sampled_from([0, 7 * S, 1_700_000_000 * S]))
    length_ns = draw(st.sampled_from([0, 300, 1500, 4000])) * MS
    frames = []
    for can_id, cycle_ns in CYCLE_NS.items():
        start_ns = int(rng.integers(0, cycle_ns)) // 1000 * 1000
        for number, t_ns in enumerate(range(t0_ns + start_ns, t0_ns + length_ns, cycle_ns)):
            data = _usual(can_id, int(rng.integers(0, 5)), number)
            frames.append(Frame(t_ns, can_id, False, data))
    frames.sort()
    for event in draw(st.lists(st.sampled_from(EVENTS), max_size=5)):
        begin = int(rng.integers(0, len(frames) + 1))
        frames = _spoil(frames, event, begin, begin + int(rng.integers(1, 160)), rng)
    return frames


def _spoil(
    frames: list[Frame], event: str, begin: int, end: int, rng: np.random.Generator
) -> list[Frame]:
    before, part, after = frames[:begin], frames[begin:end], frames[end:]
    t_ns = frames[min(begin, len(frames) - 1)].t_ns if frames else 0
    if event in STEPS_MS:
        step_ns = int(rng.integers(*STEPS_MS[event])) * MS
        return before + [f._replace(t_ns=f.t_ns + step_ns) for f in part + after]
    if event == "a message falls silent":
        gone = int(rng.choice(list(CYCLE_NS)))
        return before + [f for f in part + after if f.can_id != gone]
    if event in OWN:
        return before + OWN[event](t_ns) + part + after
    return before + SPOILT[event](part, rng) + after


def _swapped(part: list[Frame], rng: np.random.Generator) -> list[Frame]:
    order = np.argsort(np.arange(len(part)) + rng.uniform(0, rng.choice([2, 30]), len(part)))
    return [part[i] for i in order]


def _stuck(part: list[Frame], rng: np.random.Generator) -> list[Frame]:
    held: dict[int, bytes] = {}
    return [frame._replace(data=held.setdefault(frame.can_id, frame.data)) for frame in part]


def _among_foreign(part: list[Frame], rng: np.random.Generator) -> list[Frame]:
    return [each for f in part for each in (f, Frame(f.t_ns, 0x333, False, b"\1\2"))]


def _flipped(frame: Frame, rng: np.random.Generator) -> Frame:
    if rng.random() < 0.5 or not frame.data:
        return frame
    raw = bytearray(frame.data)
    raw[rng.integers(0, len(raw))] ^= 1 << int(rng.integers(0, 8))
    return frame._replace(data=bytes(raw))


def _filled(frame: Frame, byte: int) -> Frame:
    """Return a protected frame all of whose signals have the same bits."""
    if len(frame.data) != 8 or frame.can_id not in MESSAGES:
        return frame
    raw = bytearray([byte] * 6) + bytes([frame.data[6] & 0xF0 | byte & 0x0F, 0])
    raw[7] = payload_checksum("crc8_sae_j1850_id", frame.can_id, raw, 7)
    return frame._replace(data=bytes(raw))


STEPS_MS: Final = {
    "a pause": (1_000, 60_000),
    "a break": (60_000, 400_000),
    "the clock steps back": (-4_000_000, -1_000),
    "the clock steps back a little": (-900, 0),
}
OWN: Final[dict[str, Callable[[int], list[Frame]]]] = {
    "off the bus": lambda t_ns: [bus_state(t_ns, off=True)],
    "back on the bus": lambda t_ns: [bus_state(t_ns, off=False)],
    "cleared": lambda t_ns: [codes_cleared(t_ns)],
    "time marks": lambda t_ns: [time_mark(t_ns + k * 700 * MS) for k in range(3)],
}
SPOILT: Final[dict[str, Callable[[list[Frame], np.random.Generator], list[Frame]]]] = {
    "swapped": _swapped,
    "duplicates": lambda part, rng: [f for f in part for _ in range(rng.integers(1, 3))],
    "wrong checksums": lambda part, rng: [_flipped(f, rng) for f in part],
    "stuck counters": _stuck,
    "lost frames": lambda part, rng: [f for f in part if rng.random() < 0.5],
    "foreign frames": _among_foreign,
    "not available": lambda part, rng: [_filled(f, 0xFF) for f in part],
    "out of range": lambda part, rng: [_filled(f, 0) for f in part],
    "wrong lengths": lambda part, rng: [f._replace(data=f.data[: rng.integers(9)]) for f in part],
}
EVENTS: Final = (*STEPS_MS, "a message falls silent", *OWN, *SPOILT)
