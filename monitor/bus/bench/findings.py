"""What is wrong with a bus, found in the frames of a few seconds; ``findings.toml`` says it.

A cause hides its consequences: on a bus without frames no missing message is reported.
"""

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final, NamedTuple

import numpy as np

from monitor.base.counts import counted, plain
from monitor.base.types import FrameBlock
from monitor.bus.bench.interface import Interface
from monitor.bus.link.port import BusHealth
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap
from monitor.decode.log_blocks import EngineAnswers
from monitor.decode.plan import Checks, Plan
from monitor.frames.blocks import EXTENDED, chosen
from monitor.report.check import CheckResult

OTHER_RATE: Final = 1.5  # times the stated rate, or a part of it, that is no jitter
LEAST: Final = 20  # frames that tell whether two senders take turns
ENDLESS_HZ: Final = 500.0  # one frame that comes so often is sent again and again
AS_WANTED: Final = "as wanted"
HEAD: Final = f"{'message':<24}{'id':>9}{'seen':>10}{'wanted':>10}"
_LISTED: Final = 12  # identifiers in a sentence


class BusFinding(NamedTuple):
    """One thing that is wrong: its name in ``findings.toml``, and the facts of its sentence."""

    name: str
    facts: dict[str, Any]

    @property
    def lines(self) -> list[str]:
        """Return it in a sentence, and what to do about it."""
        texts = _texts()[self.name]
        return [texts[part].format_map(self.facts) for part in ("said", "remedy")]


@cache
def _texts() -> dict[str, dict[str, str]]:
    return tomllib.loads(files("monitor.bus.bench").joinpath("findings.toml").read_text("utf-8"))


@dataclass(frozen=True, slots=True)
class MessageSeen:
    """The frames of one message of the map.

    seen_hz, wanted_hz : the latter stated by the database, else the least that timeouts allow
    state : name of a finding, or "as wanted"
    """

    plan: Plan
    names: tuple[str, ...]  # of its signals
    lengths: tuple[int, ...]  # in bytes
    identifier: str
    seen_hz: float
    wanted_hz: float
    state: str

    @property
    def line(self) -> str:
        """Return the message's line of the table."""
        state = self.state if self.state == AS_WANTED else self.state.replace("_", " ").upper()
        seen, wanted = f"{plain(self.seen_hz, 3)}/s", f"{plain(self.wanted_hz, 3)}/s"
        return f"{self.plan.name:<24}{self.identifier:>9}{seen:>10}{wanted:>10}  {state}"


def messages(block: FrameBlock, bus_map: BusMap, seconds: float) -> list[MessageSeen]:
    """Return the messages of the map; one with optional signals alone only if it came."""
    decoder, found = BlockDecoder(bus_map, (*bus_map.names, *bus_map.optional)), []
    block = EngineAnswers(decoder.plans).push(block)
    for plan in decoder.plans.values():
        mask, wanted = plan.match
        own = chosen(block, (block.key & mask) == wanted)
        n, sound = len(own.key), Checks([plan]).fits(own.length, [0])
        if plan.is_optional and not n:
            continue
        channels = [channel for group in plan.groups for channel in group.channels]
        timeout_ns = min(decoder.timeouts_ns[channel] for channel in channels)
        cycle_ms = plan.message.cycle_time
        wanted_hz = 1e3 / cycle_ms if cycle_ms else 1e9 / timeout_ns
        is_fast = bool(cycle_ms) and n - 1 > OTHER_RATE * wanted_hz * seconds
        is_slow = n + 1 < wanted_hz * seconds / (OTHER_RATE if cycle_ms else 1.0)
        states = (
            ("missing", n == 0),
            ("wrong_length", not sound.all()),
            ("two_senders", _has_two_senders(plan, chosen(own, sound), is_fast)),
            ("too_slow", is_slow),
            ("too_fast", is_fast),
        )
        state = next((name for name, holds in states if holds), AS_WANTED)
        names = tuple(decoder.channels[channel] for channel in channels)
        lengths = tuple(np.unique(own.length).tolist())
        identifier = in_hex(int(wanted))
        found.append(MessageSeen(plan, names, lengths, identifier, n / seconds, wanted_hz, state))
    return found


def _has_two_senders(plan: Plan, frames: FrameBlock, is_fast: bool) -> bool:
    """Return whether each frame goes on from the one before the last, not from the last.

    The alive counter tells it. Without one a byte tells it, if the message also comes too often or
    in pairs: a message of one sender may have a bit that toggles.
    """
    if len(frames.key) < LEAST:
        return False
    data = frames.data
    if plan.counter is not None:
        count, size = Checks([plan]).counters.bits(data, [0]).astype(int), 1 << plan.counter.length
        rose_1, rose_2 = (((count[k:] - count[:-k]) % size == 1).mean() for k in (1, 2))
        return bool(rose_1 < 0.75 and rose_2 > 0.5)
    changes_1, changes_2 = ((data[k:] != data[:-k]).mean(axis=0) for k in (1, 2))
    spread_1, spread_2 = (float(np.std(frames.t_ns[k:] - frames.t_ns[:-k])) for k in (1, 2))
    is_double = (is_fast or 2.0 * spread_2 < spread_1) and not plan.is_multiplexed
    return bool(is_double and ((changes_1 > 0.8) & (changes_2 < 0.4)).any())


def of_interface(interface: Interface) -> Iterator[BusFinding]:
    """Yield the findings that need no frame."""
    facts = {"name": interface.name, "told": interface.in_words, "how": ""}
    if interface.kind == "can":
        facts["how"] = f" type can bitrate {interface.bitrate or 500_000} listen-only on"
    if not interface.is_up:
        yield BusFinding("interface_down", facts)
    elif interface.state in ("bus-off", "stopped"):
        yield BusFinding("interface_off", facts)


def of_bus(
    block: FrameBlock, health: BusHealth, interface: Interface | None
) -> Iterator[BusFinding]:
    """Yield the findings about the bus as a whole."""
    n, errors = len(block.key), health.error_frames
    is_real = interface is not None and interface.kind == "can"
    repeats = bool(health.unacknowledged or _is_endless(block))
    facts = asdict(health) | {
        "rate": "try the usual bit rates with --scan" if is_real else "try another bit rate",
        "drops": health.drops or 0,
        "errors": counted(errors, "error frame"),
        "frames": counted(n, "frame"),
    }
    table = (
        ("no_acknowledgement", repeats),
        ("only_errors", errors and not n and not repeats),
        ("some_errors", errors and n and not repeats),
        ("silent" if is_real else "silent_elsewhere", not n and not errors),
        ("controller", health.state in ("warning", "passive", "bus off")),
        ("lost_frames", health.overruns or health.drops),
        ("malformed", health.malformed),
    )
    yield from (BusFinding(name, facts) for name, holds in table if holds)


def _is_endless(block: FrameBlock) -> bool:
    """Return whether one frame comes again and again, and no other."""
    if len(block.key) < LEAST or (block.key != block.key[0]).any():
        return False
    span_s = float(block.t_ns[-1] - block.t_ns[0]) / 1e9
    return bool((block.data == block.data[0]).all() and len(block.key) > ENDLESS_HZ * span_s)


def of_messages(
    seen: Sequence[MessageSeen], block: FrameBlock, result: CheckResult, whose: str
) -> Iterator[BusFinding]:
    """Yield the findings about the map's messages and signals.

    whose : the database in words
    """
    if all(each.state == "missing" for each in seen):
        keys, counts = np.unique(block.key, return_counts=True)
        often = keys[np.argsort(-counts, kind="stable")].tolist()
        listed = " ".join(map(in_hex, often[:_LISTED])) + " …" * (len(often) > _LISTED)
        facts = {"identifiers": counted(len(often), "identifier"), "listed": listed}
        yield BusFinding("foreign", facts | {"whose": whose})
        return
    ages_ns = [result.end_ns - each.last_ns for each in result.signals if each.count]
    is_silent = not any(each.is_present(result.end_ns) for each in result.signals)
    if ages_ns and is_silent:
        yield BusFinding("stopped", {"silent": plain(min(ages_ns) / 1e9, 2)})
    untold = (AS_WANTED, *(("too_slow", "too_fast") if is_silent else ()))
    troubled = [each for each in seen if each.state not in untold]
    for each in troubled:
        facts = {"message": f"{each.plan.name} ({each.identifier})"}
        facts |= {"names": ", ".join(each.names), "lengths": " and ".join(map(str, each.lengths))}
        facts |= {"seen": plain(each.seen_hz, 3), "wanted": plain(each.wanted_hz, 3)}
        other = int(each.plan.match[1]) ^ EXTENDED
        facts |= {"size": str(each.plan.size), "bits": "29" if other & EXTENDED else "11"}
        is_elsewhere = each.state == "missing" and (block.key == other).any()
        yield BusFinding("other_width" if is_elsewhere else each.state, facts)
    explained = {name for each in troubled for name in each.names}
    yield from () if is_silent else _of_signals(result, explained)
    for reason in ("checksum", "stuck"):
        n = result.rejected.get(reason, 0)
        if n and not any(each.state == "two_senders" for each in troubled):
            yield BusFinding(reason, {"n": counted(n, "frame")})


def _of_signals(result: CheckResult, explained: set[str]) -> Iterator[BusFinding]:
    for signal in result.signals:
        verdict = signal.verdict(result.end_ns)
        if verdict == "plausible" or signal.name in explained:
            continue
        missing, outside = signal.invalid, signal.out_of_range
        name = "not_available" if missing > outside else "implausible" if outside else "late"
        facts = {"name": signal.name, "verdict": verdict, "n": max(missing, outside)}
        yield BusFinding(name, facts)


def in_hex(key: int) -> str:
    """Return an identifier as candump prints it.

    >>> in_hex(0xC0), in_hex(0x18FF00 | EXTENDED)
    ('0C0', '0018FF00')
    """
    return f"{key & (EXTENDED - 1):0{8 if key & EXTENDED else 3}X}"
