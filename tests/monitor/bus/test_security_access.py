"""UDS 0x27: clearing codes only with the user's key function."""

import math
from pathlib import Path

import pytest

from monitor.base.errors import UsageError
from monitor.bus.diagnostics.security import (
    DELAY_S,
    MOST_FAILURES,
    SEED_BYTES,
    Key,
    KeyAccess,
    key_of,
)
from tests.helpers.diagnostics_state import Vehicle, ask

CLEAR = "14 FF FF FF"


def turned(seed: bytes, level: int) -> bytes:
    """Return a key: the seed with all bits turned, and the level."""
    return bytes(255 - byte for byte in seed) + bytes((level,))


def locked(key: Key = turned) -> Vehicle:
    vehicle = Vehicle()
    vehicle.state.access = KeyAccess(key)
    return vehicle


def unlock(vehicle: Vehicle) -> str | None:
    seed = bytes.fromhex(ask("27 01", vehicle) or "")[2:]
    assert len(seed) == SEED_BYTES
    return ask(f"27 02 {turned(seed, 1).hex()}", vehicle)


def test_without_a_key_function_the_service_is_unknown_and_clearing_as_before() -> None:
    vehicle = Vehicle()
    ask("10 03", vehicle)
    assert ask("27 01", vehicle) == "7f 27 11"
    assert ask(CLEAR, vehicle) == "54"


def test_codes_are_cleared_only_with_the_right_key() -> None:
    vehicle = locked()
    assert ask("27 01", vehicle) == "7f 27 7f"  # in the default session
    assert ask("04", vehicle) == "7f 04 22"  # the service of SAE J1979 is no way round
    ask("10 03", vehicle)
    assert ask(CLEAR, vehicle) == "7f 14 33"
    assert vehicle.clearings == 0
    assert ask("27 02 00", vehicle) == "7f 27 24"  # a key before a seed
    assert unlock(vehicle) == "67 02"
    assert ask("27 01", vehicle) == "67 01" + " 00" * SEED_BYTES  # open already
    assert ask(CLEAR, vehicle) == "54"
    assert ask("04", vehicle) == "44"
    assert vehicle.clearings == 2
    # and the access ends with the session
    ask("10 03", vehicle)
    assert ask(CLEAR, vehicle) == "7f 14 33"


def test_reading_needs_no_key() -> None:
    vehicle = locked()
    for request in ("03", "19 02 FF", "22 F1 90", "01 00"):
        assert (ask(request, vehicle) or "7f")[:2] != "7f"


def test_a_seed_serves_once_and_wrong_keys_cost_time() -> None:
    vehicle = locked()
    ask("10 03", vehicle)
    seeds = set()
    for i in range(MOST_FAILURES):
        seeds.add(ask("27 01", vehicle))
        last = i == MOST_FAILURES - 1
        assert ask("27 02 12 34", vehicle) == ("7f 27 36" if last else "7f 27 35")
        assert ask("27 02 12 34", vehicle) == "7f 27 24"  # the seed is used up
    assert len(seeds) == MOST_FAILURES
    assert ask("27 01", vehicle) == "7f 27 37"
    ask("10 03", vehicle)  # a new session does not shorten the wait
    vehicle.state.now_s = DELAY_S - 0.1
    assert ask("27 01", vehicle) == "7f 27 37"
    vehicle.state.now_s = DELAY_S
    assert unlock(vehicle) == "67 02"


@pytest.mark.parametrize("request_text", ["27", "27 03", "27 01 00", "27 02", "27 42 00"])
def test_malformed_requests_are_refused(request_text: str) -> None:
    vehicle = locked()
    ask("10 03", vehicle)
    ask("27 01", vehicle)
    assert (ask(request_text, vehicle) or "")[:5] == "7f 27"
    assert ask(CLEAR, vehicle) == "7f 14 33"


def test_a_key_function_that_fails_opens_nothing() -> None:
    def broken(seed: bytes, level: int) -> bytes:
        raise OSError(f"no token for {level}")

    def empty(seed: bytes, level: int) -> bytes:
        return b""

    for key, wanted in ((broken, "7f 27 22"), (empty, "7f 27 35")):
        vehicle = locked(key)
        ask("10 03", vehicle)
        ask("27 01", vehicle)
        assert ask("27 02 00", vehicle) == wanted
        assert ask(CLEAR, vehicle) == "7f 14 33"


def test_key_functions_are_found_by_module_and_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_keys.py").write_text("def key(seed, level):\n    return seed\n\nvalue = 3\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert key_of("own_keys:key")(b"ab", 1) == b"ab"
    assert key_of("math:fsum") is math.fsum
    for name, said in (
        ("own_keys", "wanted module:function"),
        ("own_keys:other", "other"),
        ("own_keys:value", "is no function"),
        ("no_such_module:key", "no_such_module"),
    ):
        with pytest.raises(UsageError, match=said):
            key_of(name)
