"""Fuzzes the live page's server with random and mutated HTTP requests, one socket each.

It prints the answers and the server's memory. It fails if the server crashes, answers with an
internal error, grows, or no longer serves the page.

    python -m benchmarks fuzz_http --requests 100000
"""

import os
import random
import sys
import time
import urllib.request
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from benchmarks.damage.fuzz_options import fuzz_parser
from tests.helpers.http_fuzz import ask, request
from tests.helpers.live_player import Player, frames_of

WARM_UP = 2000  # requests until everything is loaded and cached
GROWTH_MB = 5.0
ROUND = 5000


def main(argv: Sequence[str]) -> int:
    """Send the requests and report."""
    parser = fuzz_parser("Fuzz the live page's server.", "requests", 100_000)
    args = parser.parse_args(argv)
    rng, answers = random.Random(args.seed), Counter[int]()
    with Player() as player:
        player.play(frames_of("healthy_micro_trips", 60.0), 60.0)
        port, pid = player.server.address.port, player.server.pid
        begin_s = time.monotonic()
        sizes: list[float] = []
        for i in range(args.requests):
            answered = ask(port, request(rng))
            answers.update(answered or [0])
            player.feed.work(time.monotonic())
            if i + 1 >= WARM_UP and (i + 1 - WARM_UP) % ROUND == 0:
                sizes.append(memory_mb(pid))
                print(f"{i + 1:>8} requests, server {sizes[-1]:.1f} MB", flush=True)
        spent_s = time.monotonic() - begin_s
        with urllib.request.urlopen(player.url, timeout=5.0) as page:
            served = page.status == 200
        lines = player.lines
    print(f"{args.requests} requests in {spent_s:.0f} s ({args.requests / spent_s:.0f} a second)")
    print("answers: " + ", ".join(f"{k or 'none'} {n}" for k, n in sorted(answers.items())))
    growth = sizes[-1] - sizes[0] if sizes else 0.0
    print(f"memory from request {WARM_UP} on: {growth:+.1f} MB; still serving: {served}")
    if lines or answers[500] or growth > GROWTH_MB or not served:
        sys.exit("FAILED")
    return 0


def memory_mb(pid: int) -> float:
    """Return the resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
