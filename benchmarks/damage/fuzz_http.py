"""Fuzz the live page's server with random and mutated HTTP requests, one socket each.

It fails if the server crashes, answers with an internal error, grows, or no longer serves the page.

python -m benchmarks fuzz_http [--cases 100000]
"""

import random
import time
import urllib.request
from collections import Counter
from collections.abc import Sequence

from benchmarks.damage.harness import fuzz_options
from benchmarks.measures import rss_mb
from benchmarks.outcome import Row, finish, say
from tests.helpers.http_fuzz import ask, request
from tests.helpers.live_player import Player, frames_of

WARM_UP = 2000  # requests until everything is loaded and cached
GROWTH_MB = 5.0
ROUND = 5000


def main(argv: Sequence[str]) -> int:
    """Send the requests and report."""
    args = fuzz_options(__name__, __doc__, 100_000, 200).parse_args(argv)
    rng, answers = random.Random(args.seed), Counter[int]()
    with Player() as player:
        player.play(frames_of("healthy_micro_trips", 60.0), 60.0)
        port, pid = player.server.address.port, player.server.pid
        begin_s, sizes = time.monotonic(), list[float]()
        for i in range(args.cases):
            answers.update(ask(port, request(rng)) or [0])
            player.feed.work(time.monotonic())
            if i + 1 >= WARM_UP and (i + 1 - WARM_UP) % ROUND == 0:
                sizes.append(rss_mb(pid))
                say(f"{i + 1:>8} requests, server {sizes[-1]:.1f} MB")
        per_s = args.cases / (time.monotonic() - begin_s)
        with urllib.request.urlopen(player.url, timeout=5.0) as page:
            served = page.status == 200
        lines = player.lines
    growth_mb = sizes[-1] - sizes[0] if sizes else 0.0
    rows: list[Row] = [{"answer": str(k or "none"), "n": n} for k, n in sorted(answers.items())]
    rows.append({"requests": args.cases, "a second": per_s, "growth_mb": growth_mb})
    missed = [*lines, *["an internal error"] * bool(answers[500])]
    missed += [f"grows by {growth_mb:.1f} MB"] * (growth_mb > GROWTH_MB) + ["the page"] * (
        not served
    )
    return finish(args, rows, missed)
