"""Fuzz ``o2mon replay`` with damaged and hostile logs and tables of every format.

Each log is a short healthy drive (``log_seeds.py``) with something wrong: bits, bytes, numbers,
lines, blocks, stretches in another order, its packing. Undamaged, every format ends with exit code
0. A crash, exit code 4, a hang of more than 5 s, more than 1 GB of memory, a failure without its
line and a code that the content of the log does not explain (``log_content.py``) are failures;
their files are kept.
"""

import functools
import gzip
import json
import random
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count, islice
from pathlib import Path
from tempfile import TemporaryDirectory

import asammdf  # noqa: F401  imported once, for all children

from benchmarks.damage.harness import Job, Tally, call, calls, fuzz_options
from benchmarks.damage.log_content import DriveContent
from benchmarks.damage.log_seeds import BINARY_KINDS, KINDS, write_seeds
from benchmarks.damage.mutations import BINARY, TEXT, flip, in_containers
from benchmarks.outcome import Row, finish, say
from monitor import cli
from monitor.cli import options, replay

SHARES = dict(zip(KINDS, (5, 3, 4, 3, 6, 2, 4, 2, 3, 3, 3), strict=True))
BATCH = 200
REPORT = 2000  # logs between two lines of progress


@dataclass(slots=True)
class FormatCounts:
    """What became of the damaged logs of one format."""

    tally: Tally = field(default_factory=Tally)
    explained: Counter[str] = field(default_factory=Counter)  # codes by what explains them


def cases(sound: dict[str, bytes], seed: int) -> Iterator[tuple[str, bytes]]:
    """Yield formats and contents of damaged logs without end."""
    rng = random.Random(seed)
    while True:
        (kind,) = rng.choices(list(SHARES), list(SHARES.values()))
        mutate = rng.choice(BINARY if kind in BINARY_KINDS else TEXT)
        content = sound[kind]
        if kind == ".blf" and rng.random() < 0.5:
            content = in_containers(content, mutate, rng)
        else:
            content = mutate(bytearray(content), rng)
        if rng.random() < 0.15:
            content = gzip.compress(content, 1)
            if rng.random() < 0.3:
                content = flip(bytearray(content), rng)
            kind += ".gz"
        yield kind, content


def healthy_seeds(folder: Path) -> dict[str, bytes]:
    """Return the undamaged drive in every format; raise RuntimeError if one is not judged."""
    if call(functools.partial(_write_seeds, folder)).code != 0:
        raise RuntimeError("the seeds cannot be written")
    outcomes = calls([replaying(folder / f"seed{kind}") for kind in KINDS])
    for kind, outcome in zip(KINDS, outcomes, strict=True):
        if outcome.code != 0:
            raise RuntimeError(f"the undamaged seed{kind} ends with {outcome}")
    return {kind: (folder / f"seed{kind}").read_bytes() for kind in KINDS}


def _write_seeds(folder: Path) -> int:
    write_seeds(folder)
    return 0


def replaying(path: Path, *more: str) -> Job:
    """Return the call that replays a log."""
    return functools.partial(cli.main, ["replay", "--quiet", str(path), *more])


def fuzz(n: int, seed: int, keep: Path) -> dict[str, FormatCounts]:
    """Replay ``n`` damaged logs; return the counts by format. Files of failures go to ``keep``."""
    setup = options.set_up(options.SetupOptions())
    replay.set_up = lambda *_, **_options: setup  # type: ignore[attr-defined]  # loaded once
    found: dict[str, FormatCounts] = defaultdict(FormatCounts)
    begun_s = time.monotonic()
    with TemporaryDirectory() as name:
        folder = Path(name)
        sound = healthy_seeds(folder)
        for kind in KINDS:
            if kind != ".parquet":  # polars has threads, which do not outlive a fork
                cli.main(["replay", "--quiet", str(folder / f"seed{kind}")])
        content = DriveContent(folder)
        source, numbers = cases(sound, seed), count()
        for first in range(0, n, BATCH):
            batch = [
                (folder / f"case{next(numbers)}{kind}", kind.removesuffix(".gz"), damaged)
                for kind, damaged in islice(source, min(BATCH, n - first))
            ]
            for path, _, damaged in batch:
                path.write_bytes(damaged)
            outcomes = calls([replaying(path) for path, _, _ in batch])
            for (path, kind, damaged), outcome in zip(batch, outcomes, strict=True):
                broken, why = found[kind].tally.add(outcome), ""
                if outcome.code == 1:
                    why = _explained(path, kind, content)
                    if why:
                        found[kind].explained[why] += 1
                    else:
                        broken.append("false code")
                        found[kind].tally.complaints["false code"] += 1
                if broken:
                    kept = keep / f"{seed}_{path.name}"
                    kept.write_bytes(damaged)
                    say(f"{', '.join(broken)}: {kept} {outcome}")
                path.unlink()
            done = min(first + BATCH, n)
            if done // REPORT > first // REPORT:
                say(f"{done} logs in {time.monotonic() - begun_s:.0f} s")
    return found


def _explained(path: Path, kind: str, content: DriveContent) -> str:
    """Return what in a damaged log explains its codes, "" if nothing does."""
    out, why = path.with_suffix(".json"), path.with_suffix(".why")
    call(replaying(path, "--json", str(out)))
    codes = sorted(d["code"] for d in json.loads(out.read_text())["recordings"][0]["dtcs"])

    def explain() -> int:
        why.write_text(content.explained(path, kind, codes))
        return 0

    call(explain)
    found = why.read_text() if why.exists() else ""
    out.unlink()
    why.unlink(missing_ok=True)
    return found


def main(argv: Sequence[str]) -> int:
    """Fuzz and count; return 1 if a promise was broken."""
    args = fuzz_options(__name__, __doc__, 100_000, 50).parse_args(argv)
    args.keep.mkdir(parents=True, exist_ok=True)
    found, whole = fuzz(args.cases, args.seed, args.keep), Tally()
    for each in found.values():
        whole.merge(each.tally)
    rows = [each.tally.row(kind) for kind, each in sorted(found.items())]
    why = Counter[str]()
    for each in found.values():
        why.update(each.explained)
    explained: list[Row] = [{"code explained by": reason, "logs": n} for reason, n in why.items()]
    return finish(args, [*rows, whole.row("all"), *explained], whole.missed())
