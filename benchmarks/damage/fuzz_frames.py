"""Fuzz the live loop with random and mutated frames beside those of a healthy drive.

A crash, a code, a detached attachment or a growth of memory is a failure. One in 256 random
payloads has a right eight-bit checksum: it is a sound frame with another content, which no monitor
can detect. Such frames are left out unless --sound is given.

python -m benchmarks fuzz_frames [--cases 1000000] [--sound]
"""

import gc
import random
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path

import can

from benchmarks.damage.harness import fuzz_options
from benchmarks.live.played import Played
from benchmarks.measures import rss_mb
from benchmarks.outcome import Row, finish
from benchmarks.repository import REPLAY_LOGS
from monitor.base import config
from monitor.base.types import Frame
from monitor.bus.link.recorder import message_of
from monitor.bus.loop import Loop
from monitor.bus.transmit import Transmitter
from monitor.decode.checksum import payload_checksum
from monitor.frames.logs import read_frames
from monitor.pipeline import replay

LOG = REPLAY_LOGS / "healthy_wltc_3b_v101_s101.blf"
BEGIN_NS = 1_700_000_000_000_000_000
N_DATA, CHECKSUM_BYTE = 8, 7  # of every message of the project's ECU
STRANGE_TIMES = (0.0, -1.0, 1e-9, 1e12, 2.0**53, float(BEGIN_NS) / 1e9)


@dataclass(frozen=True, slots=True)
class LoopFindings:
    """What the frames did to the loop."""

    frames: int  # made up, beside those of the drive
    samples: int
    windows: int
    codes: tuple[str, ...]
    detached: int
    growth_mb: float  # of the process, from a tenth of the frames on
    frames_per_s: float


def mutated(frame: Frame, rng: random.Random) -> can.Message:
    """Return a frame with something wrong."""
    message = message_of(frame)
    data = bytearray(frame.data)
    match rng.randrange(7):
        case 0 | 1:  # bits flipped
            for _ in range(rng.randint(1, 6)):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        case 2:  # cut short
            del data[rng.randrange(len(data)) :]
        case 3:  # too long
            data += rng.randbytes(rng.choice((4, 8, 24, 56)))
        case 4:  # random content under a needed identifier
            data = bytearray(rng.randbytes(len(data)))
        case 5:  # another identifier
            message.arbitration_id ^= 1 << rng.randrange(11)
        case _:  # late
            message.timestamp -= rng.random()
    message.data, message.dlc, message.is_fd = data, len(data), len(data) > 8
    return message


def random_message(t_s: float, rng: random.Random) -> can.Message:
    """Return anything a bus may bring."""
    extended = rng.random() < 0.3
    kind = rng.random()
    data = rng.randbytes(rng.choice((0, 1, 2, 3, 4, 5, 6, 7, 8, 8, 8, 12, 64)))
    return can.Message(
        timestamp=t_s,
        arbitration_id=rng.getrandbits(29 if extended else 11),
        is_extended_id=extended,
        is_error_frame=kind < 0.05,
        is_remote_frame=0.05 <= kind < 0.1,
        is_fd=len(data) > 8,
        data=b"" if 0.05 <= kind < 0.1 else data,
    )


def is_sound(message: can.Message, identifiers: set[int]) -> bool:
    """Return whether it would be taken for one of the ECU's messages, but for its counter."""
    if message.arbitration_id not in identifiers or message.dlc != N_DATA:
        return False
    data = bytes(message.data)
    return data[CHECKSUM_BYTE] == payload_checksum(
        "crc8_sae_j1850_id", message.arbitration_id, data, CHECKSUM_BYTE
    )


def messages(
    drive: list[Frame], n: int, rng: random.Random, *, sound: bool
) -> Iterator[can.Message]:
    """Yield a drive again and again until ``n`` made-up frames were among it."""
    identifiers = {frame.can_id for frame in drive}
    lap_ns = drive[-1].t_ns - drive[0].t_ns + 100_000_000
    shift_ns = BEGIN_NS - drive[0].t_ns
    while True:
        for frame in drive:
            moved = frame._replace(t_ns=frame.t_ns + shift_ns)
            if rng.random() > 0.005:
                yield message_of(moved)
            for _ in range(rng.choice((0, 1, 1, 2, 6))):
                n -= 1
                if n < 0:
                    return
                if rng.random() < 0.3:
                    message = mutated(moved, rng)
                else:
                    message = random_message(moved.t_ns / 1e9, rng)
                is_copy = bytes(message.data) == frame.data  # its counter tells
                if sound or is_copy or not is_sound(message, identifiers):
                    yield message
        shift_ns += lap_ns


def strange_times(
    drive: list[Frame], n: int, rng: random.Random, *, sound: bool
) -> Iterator[can.Message]:
    """Yield frames whose clock is mad, then the drive's own."""
    for _ in range(n):
        message = message_of(rng.choice(drive))
        message.timestamp = rng.choice(STRANGE_TIMES) + rng.choice((0.0, rng.random(), 1e5))
        yield message
    yield from map(message_of, drive)


def fuzz(
    n: int, seed: int, *, mad_clock: bool = False, sound: bool = False, log: Path = LOG
) -> LoopFindings:
    """Send ``n`` made-up frames through a loop and return what they did.

    mad_clock : the frames are sound, their times are not
    sound : with frames whose checksum is right by chance
    """
    rng, drive = random.Random(seed), list(islice(read_frames(log), n))
    play = strange_times if mad_clock else messages
    made, sizes = 0, list[float]()
    gc.freeze()  # what is loaded does not grow

    def metered() -> Iterator[can.Message]:
        nonlocal made
        for message in play(drive, n, rng, sound=sound):
            made += 1
            if made % max(n // 10, 1) == 0:
                gc.collect()
                sizes.append(rss_mb())
            yield message

    with Played(metered()) as bus:
        loop = bus.loop = Loop(
            bus,
            replay.set_up(None, (), config.load()),
            say=lambda _: None,
            monotonic_s=lambda: bus.now_s,
        )
        loop.attachments.append(Transmitter(loop.pipeline.monitor))
        start_s = time.monotonic()
        loop.run()
        took_s = time.monotonic() - start_s
    recording = loop.result("fuzz")
    return LoopFindings(
        frames=n,
        samples=recording["samples"],
        windows=len(recording["windows"]) + recording["windows_dropped"],
        codes=tuple(dtc["code"] for dtc in recording["dtcs"]),
        detached=loop.health.detached,
        growth_mb=sizes[-1] - sizes[0],
        frames_per_s=made / took_s,
    )


def main(argv: Sequence[str]) -> int:
    """Fuzz with frames, then with times; return 1 if a code came or something was detached."""
    options = fuzz_options(__name__, __doc__, 1_000_000, 5000)
    options.add_argument("--sound", action="store_true", help="with right checksums by chance")
    args = options.parse_args(argv)
    whole = {
        "frames": fuzz(args.cases, args.seed, sound=args.sound),
        "mad clock": fuzz(args.cases // 10, args.seed, mad_clock=True),
    }
    rows: list[Row] = [
        {"what": what} | asdict(found) | {"codes": " ".join(found.codes)}
        for what, found in whole.items()
    ]
    missed = [f"{what}: {found}" for what, found in whole.items() if found.detached]
    return finish(args, rows, missed + [str(c) for c in [whole["frames"].codes] if c])
