"""SecurityAccess (ISO 14229-1, 0x27): a tester proves that it knows the user's key function.

The monitor sends a random seed, the tester answers with the key that belongs to it. Without a key
function everybody may do what the other conditions allow.
"""

import hmac
import importlib
import math
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Final

from monitor.base.errors import UsageError
from monitor.bus.diagnostics.state import DEFAULT_SESSION, RefusedError, State

GROUP: Final = "o2_monitor.security_keys"  # of entry points
LEVEL: Final = 0x01  # subfunction that asks for a seed; the next one sends the key
SEED_BYTES: Final = 8
MOST_FAILURES: Final = 3  # wrong keys in a row, before the tester must wait
DELAY_S: Final = 10.0  # wait after them
SUBFUNCTION_NOT_SUPPORTED: Final = 0x12
WRONG_LENGTH: Final = 0x13
CONDITIONS_NOT_CORRECT: Final = 0x22
WRONG_SEQUENCE: Final = 0x24
DENIED: Final = 0x33
INVALID_KEY: Final = 0x35
TOO_MANY_ATTEMPTS: Final = 0x36
DELAY_NOT_OVER: Final = 0x37
SERVICE_NOT_SUPPORTED: Final = 0x11
SERVICE_NOT_IN_SESSION: Final = 0x7F
POSITIVE: Final = 0x40
SUPPRESS: Final = 0x80

Key = Callable[[bytes, int], bytes]  # of a seed and a level


@dataclass(slots=True)
class KeyAccess:
    """Access with a key function.

    key : returns the key of a seed; may raise anything
    random : returns a seed of so many bytes
    """

    key: Key
    random: Callable[[int], bytes] = secrets.token_bytes
    is_open: bool = False
    _seed: bytes | None = None
    _failures: int = 0
    _closed_until_s: float = -math.inf

    def lock(self) -> None:
        """End the access; a wrong key of before still counts."""
        self.is_open, self._seed = False, None

    def seed(self, now_s: float) -> bytes:
        """Return a seed, zeros if the access is open; raises RefusedError."""
        if now_s < self._closed_until_s:
            raise RefusedError(DELAY_NOT_OVER)
        if self.is_open:
            return bytes(SEED_BYTES)
        self._seed = self.random(SEED_BYTES)
        return self._seed

    def unlock(self, key: bytes, now_s: float) -> None:
        """Open the access with the key of the last seed; raises RefusedError."""
        seed, self._seed = self._seed, None  # a seed serves once
        if seed is None:
            raise RefusedError(WRONG_SEQUENCE)
        try:
            wanted = bytes(self.key(seed, LEVEL))
        except Exception:
            raise RefusedError(CONDITIONS_NOT_CORRECT) from None
        if hmac.compare_digest(wanted, key) and wanted:
            self.is_open, self._failures = True, 0
            return
        self._failures += 1
        if self._failures < MOST_FAILURES:
            raise RefusedError(INVALID_KEY)
        self._failures, self._closed_until_s = 0, now_s + DELAY_S
        raise RefusedError(TOO_MANY_ATTEMPTS)


def security_access(request: bytes, state: State) -> bytes | None:
    """Answer 0x27: a seed, or the result of a key."""
    access = state.access
    if not isinstance(access, KeyAccess):
        raise RefusedError(SERVICE_NOT_SUPPORTED)
    if state.session == DEFAULT_SESSION:
        raise RefusedError(SERVICE_NOT_IN_SESSION)
    if len(request) < 2:
        raise RefusedError(WRONG_LENGTH)
    subfunction, is_silent = request[1] & ~SUPPRESS, bool(request[1] & SUPPRESS)
    body = b""
    if subfunction == LEVEL:
        if len(request) != 2:
            raise RefusedError(WRONG_LENGTH)
        body = access.seed(state.now_s)
    elif subfunction == LEVEL + 1:
        if len(request) < 3:
            raise RefusedError(WRONG_LENGTH)
        access.unlock(request[2:], state.now_s)
    else:
        raise RefusedError(SUBFUNCTION_NOT_SUPPORTED)
    return None if is_silent else bytes((request[0] + POSITIVE, subfunction)) + body


def key_of(name: str) -> Key:
    """Return a key function by the name of an entry point, or as ``module:function``.

    Raises UsageError if there is none.
    """
    for point in entry_points(group=GROUP):
        if point.name == name:
            return _loaded(name, point.load)
    module, colon, function = name.partition(":")
    if not colon:
        names = ", ".join(sorted(point.name for point in entry_points(group=GROUP))) or "none"
        raise UsageError(
            f"key function {name!r}: wanted module:function, or an entry point of {GROUP!r} "
            f"(there are: {names})"
        )
    return _loaded(name, lambda: getattr(importlib.import_module(module), function))


def _loaded(name: str, load: Callable[[], Key]) -> Key:
    try:
        found = load()
    except Exception as error:
        said = str(error).splitlines()
        raise UsageError(f"key function {name!r}: {said[0] if said else error!r}") from None
    if not callable(found):
        raise UsageError(f"key function {name!r}: is no function")
    return found
