"""Frames of the project's ECU with faults put in, and what is read from them."""

from pathlib import Path

from monitor.base.types import Frame
from monitor.inject.gateway import write_log
from monitor.inject.injection import Injection
from monitor.inject.injector import Injector
from monitor.inject.rewrite import writers
from tests.conftest import ROOT
from tests.helpers.logs.batch_logs import MS, USUAL, payload
from tests.helpers.logs.bus_maps import OWN, values_of
from tests.helpers.logs.replays import frames_of

HEALTHY = ROOT / "replay_logs" / "healthy_micro_trips_v102_s102.blf"
LAMBDA_ID, FUEL_ID, AIR_ID = 0xC2, 0xC1, 0xC0
WRITER = writers(OWN.channels)[LAMBDA_ID, False]


def lambda_frames(readings: list[float], period_ms: int = 20) -> list[Frame]:
    """Sound frames of ECU_Lambda with these readings, its counter counting."""
    sent = (payload(LAMBDA_ID, USUAL | {"lambda_measured": x}, n) for n, x in enumerate(readings))
    return [Frame(n * period_ms * MS, LAMBDA_ID, False, data) for n, data in enumerate(sent)]


def decoded(frames: list[Frame], name: str = "lambda_measured") -> list[float]:
    """The values that the project's decoder takes from the frames."""
    return values_of(OWN, name, frames)


def injected(
    frames: list[Frame], *faults: Injection, seed: int = 0, keep: bool = False
) -> list[Frame]:
    return list(Injector(OWN, faults, seed=seed, keep_counters=keep).stream(frames))


def counted(frames: list[Frame]) -> list[int]:
    return [frame.data[6] >> 4 for frame in frames]


HALF_STEP = WRITER.signals["lambda_measured"].step / 2 + 1e-9


def write(path: Path, frames: list[Frame]) -> Path:
    write_log(path, frames)
    return path


def first_minutes(folder: Path, seconds: float = 210.0, from_s: float = 0.0) -> Path:
    """Write the begin of a healthy drive, or a part of it, to a log."""
    path = folder / "healthy.log"
    frames = frames_of("healthy_micro_trips", from_s + seconds)
    return write(path, [f for f in frames if f.t_ns >= frames[0].t_ns + 1e9 * from_s])
