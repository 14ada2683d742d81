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
        _package("Type", map(_base_type, (False, True))),
        _package("Unit", map(_unit, sorted({s.unit for _, s in signals if s.unit}))),
    ]
    return f"{_HEAD}<AR-PACKAGES>\n{''.join(packages)}</AR-PACKAGES>\n</AUTOSAR>\n"


def _tag(name: str, *content: str, **attributes: str) -> str:
    words = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return f"<{name}{words}>{''.join(content)}</{name}>\n"


def _named(kind: str, name: str, *content: str) -> str:
    return _tag(kind, _tag("SHORT-NAME", name), *content)


def _package(name: str, elements: Iterable[str]) -> str:
    return _named("AR-PACKAGE", name, _tag("ELEMENTS", *elements))


def _ref(tag: str, kind: str, path: str) -> str:
    return _tag(tag, path, DEST=kind)


def _unit_name(unit: str) -> str:
    return "U" + "".join(f"{ord(letter):x}" for letter in unit)


def _cluster(messages: Iterable[Message]) -> str:
    triggerings = [
        _named(
            "CAN-FRAME-TRIGGERING",
            f"T_{m.name}",
            _ref("FRAME-REF", "CAN-FRAME", f"/Frame/{m.name}"),
            _tag("CAN-ADDRESSING-MODE", "EXTENDED" if m.is_extended_frame else "STANDARD"),
            _tag("IDENTIFIER", str(m.frame_id)),
        )
        for m in messages
    ]
    channel = _named("CAN-PHYSICAL-CHANNEL", "Channel", _tag("FRAME-TRIGGERINGS", *triggerings))
    conditional = _tag(
        "CAN-CLUSTER-CONDITIONAL",
        _tag("BAUDRATE", "500000"),
        _tag("PHYSICAL-CHANNELS", channel),
        _tag("PROTOCOL-NAME", "CAN"),
    )
    return _named("CAN-CLUSTER", "Can", _tag("CAN-CLUSTER-VARIANTS", conditional))


def _frame(message: Message) -> str:
    mapping = _named(
        "PDU-TO-FRAME-MAPPING",
        f"M_{message.name}",
        _tag("PACKING-BYTE-ORDER", "MOST-SIGNIFICANT-BYTE-LAST"),
        _ref("PDU-REF", "I-SIGNAL-I-PDU", f"/Pdu/{message.name}"),
        _tag("START-POSITION", "0"),
    )
    return _named(
        "CAN-FRAME",
        message.name,
        _tag("FRAME-LENGTH", str(message.length)),
        _tag("PDU-TO-FRAME-MAPPINGS", mapping),
    )


def _pdu(message: Message) -> str:
    mappings = [
        _named(
            "I-SIGNAL-TO-I-PDU-MAPPING",
            f"M_{s.name}",
            _ref("I-SIGNAL-REF", "I-SIGNAL", f"/I_{message.name}/{s.name}"),
            _tag(
                "PACKING-BYTE-ORDER",
                "MOST-SIGNIFICANT-BYTE-" + ("LAST" if s.byte_order == "little_endian" else "FIRST"),
            ),
            _tag("START-POSITION", str(s.start)),
        )
        for s in message.signals
    ]
    return _named(
        "I-SIGNAL-I-PDU",
        message.name,
        _tag("LENGTH", str(message.length)),
        _tag("I-SIGNAL-TO-PDU-MAPPINGS", *mappings),
    )


def _i_signal(message: Message, signal: Signal) -> str:
    base = f"/Type/{'signed' if signal.is_signed else 'unsigned'}"
    conditional = _tag("SW-DATA-DEF-PROPS-CONDITIONAL", _ref("BASE-TYPE-REF", "SW-BASE-TYPE", base))
    return _named(
        "I-SIGNAL",
        signal.name,
        _tag("LENGTH", str(signal.length)),
        _tag("NETWORK-REPRESENTATION-PROPS", _tag("SW-DATA-DEF-PROPS-VARIANTS", conditional)),
        _ref("SYSTEM-SIGNAL-REF", "SYSTEM-SIGNAL", f"/Signal/{message.name}_{signal.name}"),
    )


def _system_signal(message: Message, signal: Signal) -> str:
    unit = _ref("UNIT-REF", "UNIT", f"/Unit/{_unit_name(signal.unit)}") if signal.unit else ""
    compu = _ref("COMPU-METHOD-REF", "COMPU-METHOD", f"/Compu/{message.name}_{signal.name}")
    props = _tag("SW-DATA-DEF-PROPS-CONDITIONAL", compu, unit)
    return _named(
        "SYSTEM-SIGNAL",
        f"{message.name}_{signal.name}",
        _tag("PHYSICAL-PROPS", _tag("SW-DATA-DEF-PROPS-VARIANTS", props)),
    )


def _compu(message: Message, signal: Signal) -> str:
    terms = _tag("V", str(signal.offset)), _tag("V", str(signal.scale))
    rational = _tag(
        "COMPU-RATIONAL-COEFFS",
        _tag("COMPU-NUMERATOR", *terms),
        _tag("COMPU-DENOMINATOR", _tag("V", "1")),
    )
    return _named(
        "COMPU-METHOD",
        f"{message.name}_{signal.name}",
        _tag("CATEGORY", "LINEAR"),
        _tag(
            "COMPU-INTERNAL-TO-PHYS",
            _tag("COMPU-SCALES", _tag("COMPU-SCALE", rational)),
        ),
    )


def _base_type(signed: bool) -> str:
    return _named(
        "SW-BASE-TYPE",
        "signed" if signed else "unsigned",
        _tag("CATEGORY", "FIXED_LENGTH"),
        _tag("BASE-TYPE-ENCODING", "2C" if signed else "NONE"),
    )


def _unit(unit: str) -> str:
    return _named("UNIT", _unit_name(unit), _tag("DISPLAY-NAME", escape(unit)))
