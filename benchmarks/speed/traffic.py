"""Synthetic logs: a simulated drive of the project's own ECU, alone or on a full bus."""

from typing import Final

import numpy as np

from monitor.base.types import FrameBlock
from training.dyno import ecu
from training.dyno.simulation import Experiment, simulate
from training.recordings.files.can_log import merge

FRAMES_PER_S: Final = 4_000  # a full bus of 500 kbit/s
FOREIGN_IDS: Final = 60
LAP_S: Final = 1800.0  # length of the driving cycle
FIRST_VEHICLE, FIRST_SEED = 2000, 2_000_000


def experiment(number: int, seconds: float) -> Experiment:
    """Return a healthy drive of a vehicle of its own."""
    return Experiment(vehicle=FIRST_VEHICLE + number, seed=FIRST_SEED + number, duration_s=seconds)


def own(seconds: float) -> FrameBlock:
    """Return the ECU's frames of a drive, 200 a second, all needed."""
    rng = np.random.default_rng(FIRST_SEED)
    sent = ecu.broadcast(simulate(experiment(0, seconds)), ecu.own_bus(), rng, None, 0.0)
    return ecu.frames(sent)


def full_bus(seconds: float) -> FrameBlock:
    """Return such drives, one after the other, among foreign traffic that fills the bus."""
    laps = [_full(min(seconds - lap, LAP_S), lap) for lap in np.arange(0.0, seconds, LAP_S)]
    return laps[0] if len(laps) == 1 else merge(laps)


def _full(seconds: float, shift_s: float) -> FrameBlock:
    frames, rng = own(seconds), np.random.default_rng(FIRST_SEED)
    frames = frames._replace(t_ns=frames.t_ns + round(shift_s * 1e9))
    span_ns = int(frames.t_ns[-1] - frames.t_ns[0])
    n = int(span_ns / 1e9 * FRAMES_PER_S) - len(frames.t_ns)
    foreign = FrameBlock(
        frames.t_ns[0] + np.linspace(0, span_ns, n).astype(np.int64) // 1000 * 1000,
        rng.choice(np.arange(0x300, 0x300 + FOREIGN_IDS), n).astype(np.uint32),
        np.full(n, 8, dtype=np.uint8),
        rng.integers(0, 256, (n, 8), dtype=np.uint8),
    )
    return merge([frames, foreign])


def foreign_dbc() -> str:
    """Return a database of the foreign messages, four signals of two bytes in each."""
    signals = "".join(f' SG_ S{i} : {16 * i}|16@1+ (0.01,0) [0|655] "" X\n' for i in range(4))
    messages = "".join(f"BO_ {0x300 + i} Foreign{i}: 8 X\n{signals}\n" for i in range(FOREIGN_IDS))
    return f'VERSION ""\n\nBU_: X\n\n{messages}'
