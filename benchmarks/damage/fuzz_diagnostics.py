"""Fuzz the diagnostics with random and mutated requests and ISO-TP frames, a million of each.

It fails if an answer is invalid, a code or counter changes while the engine runs, or memory grows.
can-isotp's clock is replaced, so that timeouts are as frequent as everything else.

python -m benchmarks fuzz_diagnostics [--cases 1000000]
"""

import gc
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final
from unittest.mock import patch

import isotp.tools

from benchmarks.damage.harness import fuzz_options
from benchmarks.measures import rss_mb
from benchmarks.outcome import Row, finish, say
from monitor.base.types import Frame
from monitor.bus.diagnostics.server import Diagnostics, answer
from tests.helpers.bus.diagnostics_state import Vehicle, tick

_VALID: Final = (
    "0100 0101 010120404100 011C41 020200 020C000D00 03 04 0600 0601 07 0900 0902 0904 0906 "
    "0908 090A 0A 1001 1003 1083 3E00 3E80 14FFFFFF 14FFFF33 1901FF 19020C 190A 1904013300FF "
    "1906013300FF 1906219500FF 22F190 1903 "
    "190401330000 1904013300F0"
)
VALID: Final = [bytes.fromhex(text) for text in _VALID.split()]
FLOW_CONTROL: Final = bytes.fromhex("300000 300100 30007F 3000F1 310000 320000 330000")
GROWTH_BLOCKS: Final = 500  # of what Python has allocated, over the second half of a run
GROWTH_MB: Final = 2.0  # of the process, over the same
LEAST_MEASURED: Final = 10_000  # requests; before, caches fill
REQUESTS: Final = (0x7E1, 0x7E1, 0x7DF)


class IsoTpClock:
    """Stands in for the module ``time`` inside can-isotp."""

    now_s = 1000.0

    def perf_counter_ns(self) -> int:
        """Return the time of the run."""
        return round(self.now_s * 1e9)


def request(rng: random.Random) -> bytes:
    """Return a valid request, one with a few changes, or nothing but noise."""
    kind = rng.random()
    if kind < 0.2:
        return rng.randbytes(rng.choice((0, 1, 2, 3, 4, 6, 7, 20, 64, 300)))
    data = bytearray(rng.choice(VALID))
    if kind < 0.3:
        return bytes(data)
    for _ in range(rng.randint(1, 3)):
        change, at = rng.randrange(4), rng.randrange(len(data) + 1)
        if change == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif change == 1:
            data[at:at] = rng.randbytes(rng.randint(1, 4))
        elif change == 2:
            del data[at : at + 2]
        elif at < len(data):
            data[at] = rng.randrange(256)
    return bytes(data)


def segments(data: bytes, rng: random.Random) -> Iterator[bytes]:
    """Yield a request as frames, now and then wrongly."""
    if len(data) < 8:
        yield bytes((len(data),)) + data
        return
    length = len(data) if rng.random() < 0.8 else rng.randrange(4096)
    yield bytes((0x10 | length >> 8 & 0xF, length & 0xFF)) + data[:6]
    for number, start in enumerate(range(6, len(data), 7), start=1):
        kind = rng.random()
        if kind < 0.02:
            continue  # lost
        sequence = number % 16 if kind < 0.95 else rng.randrange(16)
        yield bytes((0x20 | sequence,)) + data[start : start + 7]


def frames(rng: random.Random) -> Iterator[bytes]:
    """Yield frames without end."""
    while True:
        kind = rng.random()
        if kind < 0.25:
            yield rng.randbytes(rng.choice((0, 1, 2, 3, 8, 8, 8, 12, 64)))
        elif kind < 0.45:
            start = 3 * rng.randrange(len(FLOW_CONTROL) // 3)
            yield FLOW_CONTROL[start : start + 3]
        elif kind < 0.5:  # consecutive frames that nobody began
            for number in range(rng.randint(1, 40)):
                yield bytes((0x20 | number % 16,)) + rng.randbytes(7)
        else:
            for frame in segments(request(rng), rng):
                changed = bytearray(frame)
                if changed and rng.random() < 0.05:
                    changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
                yield bytes(changed)


class FuzzRun:
    """One vehicle under fire, with its memory watched."""

    def __init__(self, name: str, engine_speed_rpm: float) -> None:
        self.name, self.vehicle = name, Vehicle(engine_speed_rpm)
        self.before = self.vehicle.store.saved
        self.engine_runs = engine_speed_rpm > 0.0
        self.kinds: Counter[str] = Counter()
        self.started_s, self.blocks, self.mb = time.perf_counter(), 0, 0.0

    def check(self, data: bytes, answered: bytes | None) -> None:
        """Count an answer; raise AssertionError if it does not answer the request."""
        if answered is None:
            self.kinds["silent"] += 1
        elif answered[0] == 0x7F:
            assert len(answered) == 3 and answered[1] == data[0], (data, answered)
            self.kinds[f"refused 0x{answered[2]:02X}"] += 1
        else:
            assert answered[0] == data[0] + 0x40 and len(answered) <= 512, (data, answered)
            self.kinds["answered"] += 1

    def half(self) -> None:
        """Remember what is allocated."""
        gc.collect()
        self.blocks, self.mb = sys.getallocatedblocks(), rss_mb()

    def end(self, count: int) -> Row:
        """Return what came of it; raise AssertionError if something has changed."""
        gc.collect()
        blocks, mb = sys.getallocatedblocks() - self.blocks, rss_mb() - self.mb
        rate = count / (time.perf_counter() - self.started_s)
        if count >= LEAST_MEASURED:
            assert blocks < GROWTH_BLOCKS and mb < GROWTH_MB, (self.name, blocks, mb)
        if self.engine_runs:
            assert self.vehicle.clearings == 0
            assert self.vehicle.store.saved == self.before
        say(f"{self.name}: {', '.join(f'{name} {n}' for name, n in self.kinds.most_common())}")
        return {
            "what": self.name,
            "n": count,
            "a second": rate,
            "clearings": self.vehicle.clearings,
            "more blocks": blocks,
            "more_mb": mb,
        }


def fuzz_requests(count: int, rng: random.Random, engine_speed_rpm: float) -> Row:
    """Ask the services directly."""
    run = FuzzRun(f"requests at {engine_speed_rpm:g} 1/min", engine_speed_rpm)
    for number in range(count):
        if number == count // 2:
            run.half()
        data = request(rng)
        run.check(data, answer(data, rng.random() < 0.3, run.vehicle.state))
    return run.end(count)


def fuzz_frames(count: int, rng: random.Random, engine_speed_rpm: float, clock: IsoTpClock) -> Row:
    """Ask through ISO-TP."""
    run = FuzzRun(f"frames at {engine_speed_rpm:g} 1/min", engine_speed_rpm)
    server = Diagnostics(run.vehicle.state)
    source, sample = frames(rng), tick(engine_speed_rpm)
    for number in range(count):
        if number == count // 2:
            run.half()
        clock.now_s += rng.choice((0.0, 0.001, 0.01, 0.01, 0.02, 0.05, 0.2))
        if rng.random() < 0.001:
            clock.now_s += rng.choice((1.0, 5.0, 60.0))  # timeouts
        if number % 50 == 0:
            server.push(sample)
        server.receive(Frame(0, rng.choice(REQUESTS), False, next(source)))
        for _ in range(rng.randint(1, 3)):
            for frame in server.work(clock.now_s):
                assert len(frame.data) == 8 and frame.data[0] < 0x40
                run.kinds[
                    ("single", "first", "consecutive", "flow control")[frame.data[0] >> 4]
                ] += 1
    return run.end(count)


def main(argv: Sequence[str]) -> int:
    """Run all."""
    args = fuzz_options(__name__, __doc__, 1_000_000, 500).parse_args(argv)
    rows: list[Row] = []
    with patch.object(isotp.tools, "time", clock := IsoTpClock()):
        for engine_speed_rpm in (800.0, 0.0):
            rows.append(fuzz_requests(args.cases, random.Random(args.seed), engine_speed_rpm))
            rng = random.Random(args.seed + 1)
            rows.append(fuzz_frames(args.cases, rng, engine_speed_rpm, clock))
    return finish(args, rows)
