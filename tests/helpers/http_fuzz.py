"""Random and mutated HTTP requests, and a client that sends them over sockets."""

import random
import re
import socket

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
