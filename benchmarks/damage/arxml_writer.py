"""A CAN database as ARXML (AUTOSAR 4), which cantools reads but does not write; for fuzzers.

It holds frames, signals, scales, offsets and units, no multiplexers.
"""

from collections.abc import Iterable
from xml.sax.saxutils import escape

from cantools.database.can import Database, Message, Signal

_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<AUTOSAR xmlns="http://autosar.org/schema/r4.0" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:schemaLocation="http://autosar.org/schema/r4.0 AUTOSAR_4-2-2.xsd">
"""


def arxml_of(database: Database) -> str:
    """Return the database's plain messages as ARXML."""
    messages = [m for m in database.messages if not m.is_multiplexed()]
    signals = [(m, s) for m in messages for s in m.signals]
    packages = [
        _package("Cluster", [_cluster(messages)]),
        _package("Frame", map(_frame, messages)),
        _package("Pdu", map(_pdu, messages)),
        *(_package(f"I_{m.name}", [_i_signal(m, s) for s in m.signals]) for m in messages),
        _package("Signal", [_system_signal(m, s) for m, s in signals]),
        _package("Compu", [_compu(m, s) for m, s in signals]),
        _package("Type", map(_base_type, ("unsigned", "signed"))),
        _package("Unit", map(_unit, sorted({s.unit for _, s in signals if s.unit}))),
    ]
    return f"{_HEAD}{_in('AR-PACKAGES', *packages)}</AUTOSAR>\n"


def _in(tags: str, *content: str) -> str:
    """Return the content in nested elements, the outermost first; "TAG:KIND" refers to a kind."""
    text = "".join(content)
    for tag in reversed(tags.split(" ")):
        name, _, kind = tag.partition(":")
        text = f'<{name} DEST="{kind}">{text}</{name}>\n' if kind else f"<{name}>{text}</{name}>\n"
    return text


def _named(kind: str, name: str, *content: str) -> str:
    return _in(kind, _in("SHORT-NAME", name), *content)


def _package(name: str, elements: Iterable[str]) -> str:
    return _named("AR-PACKAGE", name, _in("ELEMENTS", *elements))


def _unit_name(unit: str) -> str:
    return "U" + "".join(f"{ord(letter):x}" for letter in unit)


def _cluster(messages: Iterable[Message]) -> str:
    triggerings = [
        _named(
            "CAN-FRAME-TRIGGERING",
            f"T_{m.name}",
            _in("FRAME-REF:CAN-FRAME", f"/Frame/{m.name}"),
            _in("CAN-ADDRESSING-MODE", "EXTENDED" if m.is_extended_frame else "STANDARD"),
            _in("IDENTIFIER", str(m.frame_id)),
        )
        for m in messages
    ]
    channel = _named("CAN-PHYSICAL-CHANNEL", "Channel", _in("FRAME-TRIGGERINGS", *triggerings))
    return _named(
        "CAN-CLUSTER",
        "Can",
        _in(
            "CAN-CLUSTER-VARIANTS CAN-CLUSTER-CONDITIONAL",
            _in("BAUDRATE", "500000"),
            _in("PHYSICAL-CHANNELS", channel),
            _in("PROTOCOL-NAME", "CAN"),
        ),
    )


def _frame(message: Message) -> str:
    mapping = _named(
        "PDU-TO-FRAME-MAPPING",
        f"M_{message.name}",
        _in("PACKING-BYTE-ORDER", "MOST-SIGNIFICANT-BYTE-LAST"),
        _in("PDU-REF:I-SIGNAL-I-PDU", f"/Pdu/{message.name}"),
        _in("START-POSITION", "0"),
    )
    length = _in("FRAME-LENGTH", str(message.length))
    return _named("CAN-FRAME", message.name, length, _in("PDU-TO-FRAME-MAPPINGS", mapping))


def _pdu(message: Message) -> str:
    mappings = [
        _named(
            "I-SIGNAL-TO-I-PDU-MAPPING",
            f"M_{s.name}",
            _in("I-SIGNAL-REF:I-SIGNAL", f"/I_{message.name}/{s.name}"),
            _in("PACKING-BYTE-ORDER", f"MOST-SIGNIFICANT-BYTE-{_END[s.byte_order]}"),
            _in("START-POSITION", str(s.start)),
        )
        for s in message.signals
    ]
    length = _in("LENGTH", str(message.length))
    return _named(
        "I-SIGNAL-I-PDU", message.name, length, _in("I-SIGNAL-TO-PDU-MAPPINGS", *mappings)
    )


_END = {"little_endian": "LAST", "big_endian": "FIRST"}
_VARIANT = "SW-DATA-DEF-PROPS-VARIANTS SW-DATA-DEF-PROPS-CONDITIONAL"


def _i_signal(message: Message, signal: Signal) -> str:
    base = f"/Type/{'signed' if signal.is_signed else 'unsigned'}"
    return _named(
        "I-SIGNAL",
        signal.name,
        _in("LENGTH", str(signal.length)),
        _in(f"NETWORK-REPRESENTATION-PROPS {_VARIANT} BASE-TYPE-REF:SW-BASE-TYPE", base),
        _in("SYSTEM-SIGNAL-REF:SYSTEM-SIGNAL", f"/Signal/{message.name}_{signal.name}"),
    )


def _system_signal(message: Message, signal: Signal) -> str:
    name = f"{message.name}_{signal.name}"
    unit = _in("UNIT-REF:UNIT", f"/Unit/{_unit_name(signal.unit)}") if signal.unit else ""
    compu = _in("COMPU-METHOD-REF:COMPU-METHOD", f"/Compu/{name}")
    return _named("SYSTEM-SIGNAL", name, _in(f"PHYSICAL-PROPS {_VARIANT}", compu, unit))


def _compu(message: Message, signal: Signal) -> str:
    rational = _in(
        "COMPU-INTERNAL-TO-PHYS COMPU-SCALES COMPU-SCALE COMPU-RATIONAL-COEFFS",
        _in("COMPU-NUMERATOR", _in("V", str(signal.offset)), _in("V", str(signal.scale))),
        _in("COMPU-DENOMINATOR V", "1"),
    )
    name = f"{message.name}_{signal.name}"
    return _named("COMPU-METHOD", name, _in("CATEGORY", "LINEAR"), rational)


def _base_type(name: str) -> str:
    encoding = _in("BASE-TYPE-ENCODING", "2C" if name == "signed" else "NONE")
    return _named("SW-BASE-TYPE", name, _in("CATEGORY", "FIXED_LENGTH"), encoding)


def _unit(unit: str) -> str:
    return _named("UNIT", _unit_name(unit), _in("DISPLAY-NAME", escape(unit)))
