"""Fuzz the live page's server with random and mutated HTTP requests, one socket each.

It fails if the server crashes, answers with an internal error, grows, or no longer serves the page.

python -m benchmarks fuzz_http [--cases 100000]
"""

import random
import re
import socket
import time
import urllib.request
from collections import Counter
from collections.abc import Sequence

from benchmarks.damage.harness import fuzz_options
from benchmarks.measures import rss_mb
from benchmarks.outcome import Row, finish, say
from tests.helpers.bus.live_player import Player
from tests.helpers.logs.replays import frames_of

_METHODS = [b"GET", b"HEAD", b"POST", b"PUT", b"OPTIONS", b"CONNECT", b"TRACE", b"PRI", b"get", b""]
_PATHS = [b"/", b"/live.js", b"/events", b"/../x", b"/%00", b"*", b"http://a/", b"//", b"/?a=" * 50]
_HEADERS = [
    b"Host: localhost",
    b"Host: evil.example",
    b"Host: \xff\xfe",
    b"Content-Length: 5",
    b"Content-Length: -1",
    b"Content-Length: 99999999999999999999",
    b"Transfer-Encoding: chunked",
    b"Transfer-Encoding: gzip, chunked",
    b"Connection: close",
    b"Connection: Upgrade",
    b"Upgrade: websocket",
    b"Upgrade: h2c",
    b"Sec-WebSocket-Key: AAAA",
    b"Expect: 100-continue",
    b"Range: bytes=0-1",
    b"Last-Event-ID: 1\x00",
    b"X: " + b"y" * 3000,
    b" folded",
    b":",
    b"Sec-Fetch-Site: cross-site",
]
_BODIES = [b"", b"", b"hello", b"5\r\nhello\r\n0\r\n\r\n", b"ffffffffffffffffff\r\n", b"\x00" * 100]
_LINE = re.compile(rb"HTTP/1\.1 (\d{3}) ")
ALLOWED = {0, 200, 400, 403, 404, 405, 421, 431, 503}  # 0: none


def request(rng: random.Random) -> bytes:
    """Return one request: well formed, odd, or with bytes changed."""
    if rng.random() < 0.05:
        return rng.randbytes(rng.randrange(1, 400))
    version = rng.choice([b"HTTP/1.1", b"HTTP/1.1", b"HTTP/1.0", b"HTTP/2.0", b"HTTQ/1.1", b""])
    headers = [b"Host: 127.0.0.1"] * (rng.random() < 0.8)
    headers += rng.sample(_HEADERS, rng.choice([0, 0, 1, 1, 2, 3]))
    first = b" ".join(
        [rng.choice(_METHODS[:3] if rng.random() < 0.7 else _METHODS), rng.choice(_PATHS), version]
    )
    text = b"\r\n".join([first, *headers, b"", rng.choice(_BODIES)])
    if rng.random() < 0.3:
        changed = bytearray(text)
        for _ in range(rng.randrange(1, 6)):
            changed[rng.randrange(len(changed))] = rng.randrange(256)
        text = bytes(changed)
    return text[: rng.randrange(1, len(text) + 1)] if rng.random() < 0.1 else text


def ask(port: int, text: bytes, timeout_s: float = 2.0) -> list[int]:
    """Send a request on a connection of its own; return the status codes that came back.

    The client closes its sending side, reads a little and leaves, whatever it was sent.
    """
    with socket.create_connection(("127.0.0.1", port), timeout_s) as client:
        try:
            client.sendall(text)
            client.shutdown(socket.SHUT_WR)
            answer = client.recv(65536)
        except (ConnectionError, TimeoutError):
            return []
    return [int(status) for status in _LINE.findall(answer)]


WARM_UP = 200  # requests until everything is loaded and cached
GROWTH_MB = 5.0
ROUND = 600


def main(argv: Sequence[str]) -> int:
    """Send the requests and report."""
    args = fuzz_options(__name__, __doc__, 100_000, 800).parse_args(argv)
    rng, answers = random.Random(args.seed), Counter[int]()
    with Player() as player:
        player.push(frames_of("healthy_micro_trips", 60.0), 60.0)
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
    missed = [*lines, *["another status"] * (not answers.keys() <= ALLOWED)]
    missed += [f"grows by {growth_mb:.1f} MB"] * (growth_mb > GROWTH_MB) + ["the page"] * (
        not served
    )
    return finish(args, rows, missed)
