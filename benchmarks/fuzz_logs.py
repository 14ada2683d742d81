"""Fuzzes ``o2mon replay`` with damaged and hostile logs and tables of every format.

Each log is a short healthy drive with something wrong: bits, bytes, numbers, lines, blocks, its
packing. A crash, exit code 4, a hang of more than 5 s, more than 1 GB of memory, a failure without
its line and a code that the healthy drive does not give are failures; their files are kept.
"""

import functools
import gzip
import random
import struct
import sys
import time
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from itertools import count, islice
from pathlib import Path
from tempfile import TemporaryDirectory

import asammdf  # noqa: F401  imported once, for all children
import numpy as np
from fuzz_options import fuzz_parser
from sandbox import Job, Tally, calls

from monitor import cli
from monitor.base.types import Frame
from monitor.cli import options, replay
from monitor.frames.logs import read_frames
from monitor.inject.gateway import write_log
from training.recordings.frame_block import FrameBlock
from training.recordings.mf4_log import write_mf4
from training.recordings.recording import load, write_table

ROOT = Path(__file__).resolve().parent.parent
DRIVE = ROOT / "replay_logs" / "healthy_wltc_3b_v101_s101.blf"
KINDS = (".log", ".asc", ".csv", ".trc", ".blf", ".mf4", ".table.csv")
SHARES = (6, 3, 4, 3, 6, 1, 4)
N_FRAMES = 600
BATCH = 200
NUMBERS = (
    *(b"nan inf -inf 1e308 -1 0 1e-320 9007199254740993 4294967296 -9223372036854775809".split()),
    *(b"1_0 0x10 1e5 99999999999 \xd9\xa3 ,, ;".split()),
    b"9" * 5000,
    b"",
)
WORDS = tuple(
    struct.pack("<Q", n)
    for n in (0, 1, 23, 64, 2**16, 2**31, 2**32 - 1, 2**32, 2**40, 2**63, 2**64 - 1)
)

Mutation = Callable[[bytearray, random.Random], bytes]


def flip(data: bytearray, rng: random.Random) -> bytes:
    """Return the data with some bits flipped."""
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def write_over(data: bytearray, rng: random.Random) -> bytes:
    """Return the data with a run of bytes replaced."""
    at, n = rng.randrange(len(data)), rng.choice((1, 4, 8, 100, 5000))
    data[at : at + n] = rng.choice(
        (rng.randbytes(n), bytes(n), b"\xff" * n, b"\n" * n, b"A" * n, b"[" * n)
    )
    return bytes(data)


def cut(data: bytearray, rng: random.Random) -> bytes:
    """Return the data without its end."""
    return bytes(data[: rng.randrange(1, len(data))])


def leave_out(data: bytearray, rng: random.Random) -> bytes:
    """Return the data without a run of bytes."""
    at = rng.randrange(len(data))
    del data[at : at + rng.choice((1, 7, 200, 20_000))]
    return bytes(data)


def double(data: bytearray, rng: random.Random) -> bytes:
    """Return the data with a run of bytes put in again elsewhere."""
    at, to, n = rng.randrange(len(data)), rng.randrange(len(data)), rng.choice((8, 200, 20_000))
    data[to:to] = data[at : at + n] * rng.choice((1, 1, 1, 50))
    return bytes(data)


def word(data: bytearray, rng: random.Random) -> bytes:
    """Return the data with a field of 4 or 8 bytes made a number that no logger writes."""
    for _ in range(rng.choice((1, 1, 3))):
        value = rng.choice(WORDS)[: rng.choice((4, 8))]
        at = rng.randrange(min(len(data), rng.choice((64, 700, len(data)))))
        data[at : at + len(value)] = value
    return bytes(data)


def number(data: bytearray, rng: random.Random) -> bytes:
    """Return a text with one or many numbers replaced."""
    lines = bytes(data).splitlines(keepends=True)
    row = rng.randrange(len(lines))
    separator = rng.choice((b" ", b",", b"#", b"."))
    for line in range(row, min(len(lines), row + rng.choice((1, 1, 2, 1000)))):
        cells = lines[line].split(separator)
        cells[rng.randrange(len(cells))] = rng.choice(NUMBERS)
        lines[line] = separator.join(cells)
    return b"".join(lines)


def lines_of_order(data: bytearray, rng: random.Random) -> bytes:
    """Return a text with lines swapped, doubled, left out or in another order."""
    lines = bytes(data).splitlines(keepends=True)
    match rng.randrange(4):
        case 0:
            rng.shuffle(lines)
        case 1:
            lines = lines[::-1]
        case 2:
            lines = [line for line in lines if rng.random() < 0.9]
        case _:
            at = rng.randrange(len(lines))
            lines[at:at] = lines[:at]
    return b"".join(lines)


def ends(data: bytearray, rng: random.Random) -> bytes:
    """Return a text with other line ends, a byte order mark, or zeros between."""
    text = bytes(data)
    return rng.choice(
        (
            text.replace(b"\n", b"\r"),
            text.replace(b"\n", b"\r\n"),
            b"\xef\xbb\xbf" + text,
            text.decode("latin-1").encode("utf-16"),
            text.replace(b"\n", b"\n\n\n"),
            text.replace(b"\n", b"\0\n"),
            text.replace(b"\n", b" "),
        )
    )


BINARY: tuple[Mutation, ...] = (flip, write_over, cut, leave_out, double, word, word)
TEXT: tuple[Mutation, ...] = (*BINARY[:-2], number, number, lines_of_order, ends)


def in_containers(data: bytes, mutate: Mutation, rng: random.Random) -> bytes:
    """Return a BLF file whose containers hold changed objects."""
    parts, position = [], data.index(b"LOBJ")
    parts.append(data[:position])
    while position < len(data):
        _, _, _, size, kind = struct.unpack_from("<4sHHLL", data, position)
        body = data[position + 32 : position + size]
        if kind == 10:
            inner = mutate(bytearray(zlib.decompress(body)), rng)
            body = zlib.compress(inner)
            head = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 + len(body), 10)
            body = head + struct.pack("<H6xL4x", 2, len(inner)) + body
            parts.append(body + bytes(len(body) % 4))
        position += size + size % 4
    return b"".join(parts)


def seeds(folder: Path) -> dict[str, bytes]:
    """Return a healthy drive in every format."""
    frames = list(islice(read_frames(DRIVE), N_FRAMES))
    found = {}
    for kind in KINDS:
        path = folder / f"seed{kind}"
        if kind == ".table.csv":
            recording = load(folder / "seed.log", period_s=0.1)
            held = np.nan_to_num(recording.values, nan=1.0)
            write_table(path, recording.t_s, recording.names, held)
        elif kind == ".mf4":
            write_mf4(path, side_by_side(frames))
        else:
            write_log(path, frames)
        found[kind] = path.read_bytes()
    return found


def side_by_side(frames: list[Frame]) -> FrameBlock:
    """Return frames of 8 bytes as one block."""
    return FrameBlock(
        np.array([f.t_ns for f in frames]),
        np.array([f.can_id for f in frames]),
        np.array([f.is_extended for f in frames]),
        np.array([len(f.data) for f in frames]),
        np.array([list(f.data.ljust(8, b"\0")) for f in frames], dtype=np.uint8),
    )


def cases(sound: dict[str, bytes], seed: int) -> Iterator[tuple[str, bytes]]:
    """Yield names and contents of damaged logs without end."""
    rng = random.Random(seed)
    for number_ in count():
        (kind,) = rng.choices(KINDS, SHARES)
        mutate = rng.choice(BINARY if kind in (".blf", ".mf4") else TEXT)
        content = sound[kind]
        if kind == ".blf" and rng.random() < 0.5:
            content = in_containers(content, mutate, rng)
        else:
            content = mutate(bytearray(content), rng)
        name = f"case{number_}{kind}"
        if rng.random() < 0.15:
            content = gzip.compress(content, 1)
            if rng.random() < 0.3:
                content = flip(bytearray(content), rng)
            name += ".gz"
        yield name, content


def fuzz(n: int, seed: int, keep: Path, say: Callable[[str], None] = print) -> dict[str, Tally]:
    """Replay ``n`` damaged logs; return the counts by format. Files of failures go to ``keep``."""
    setup = options.set_up(cli._parser(["replay"]).parse_args(["replay", "x"]))
    replay.set_up = lambda _: setup  # type: ignore[assignment]  # loaded once
    tallies: dict[str, Tally] = defaultdict(Tally)
    begun_s = time.monotonic()
    with TemporaryDirectory() as name:
        folder = Path(name)
        sound = seeds(folder)
        for kind, content in sound.items():
            (folder / f"warm{kind}").write_bytes(content)
            cli.main(["replay", "--quiet", str(folder / f"warm{kind}")])
        source, done = cases(sound, seed), 0
        while done < n:
            batch = [
                (folder / f"{done}_{i}_{c[0]}", c[1])
                for i, c in enumerate(islice(source, min(BATCH, n - done)))
            ]
            for path, content in batch:
                path.write_bytes(content)
            jobs: list[Job] = [
                functools.partial(cli.main, ["replay", "--quiet", str(path)]) for path, _ in batch
            ]
            for (path, content), outcome in zip(batch, calls(jobs), strict=True):
                kind = "".join(path.suffixes).removesuffix(".gz")
                broken = tallies[kind].add(outcome)
                if outcome.code == 1:
                    broken.append("false code")
                    tallies[kind].complaints["false code"] += 1
                if broken:
                    kept = keep / f"{seed}_{path.name}"
                    kept.write_bytes(content)
                    say(f"{', '.join(broken)}: {kept} {outcome}")
                path.unlink()
            done += len(batch)
            if done % 2000 == 0:
                took_s = time.monotonic() - begun_s
                say(f"{done} logs in {took_s:.0f} s")
    return tallies


def main() -> int:
    """Fuzz and print the counts; return 1 if a promise was broken."""
    parser = fuzz_parser(__doc__, "logs", 100_000, keeps=True)
    args = parser.parse_args()
    args.keep.mkdir(parents=True, exist_ok=True)
    tallies = fuzz(args.logs, args.seed, args.keep, lambda line: print(line, flush=True))
    for kind, tally in sorted(tallies.items()):
        print(f"{kind}: {tally.line()}")
    return 1 if any(tally.complaints for tally in tallies.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
