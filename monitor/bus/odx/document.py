"""An ODX-D document under construction: data objects, structures, fields and services.

Source: ISO 22901-1 (ODX 2.2.0). Every part is made once and referred to by its identifier.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple
from xml.etree import ElementTree as Xml

from monitor.bus.odx.layout import TO_THE_END, Field, Fields

_XSI: Final = "http://www.w3.org/2001/XMLSchema-instance"
_TYPES: Final = {
    "number": ("A_UINT32", "A_UINT32"),
    "float": ("A_FLOAT32", "A_FLOAT32"),
    "text": ("A_ASCIISTRING", "A_UNICODE2STRING"),
    "bytes": ("A_BYTEFIELD", "A_BYTEFIELD"),
}
_GROUPS: Final = ("DTC-DOPS", "DATA-OBJECT-PROPS", "STRUCTURES", "DYNAMIC-LENGTH-FIELDS")
_FIELDS: Final = ("END-OF-PDU-FIELDS", "MUXS")
_MESSAGES: Final = ("DIAG-COMMS", "REQUESTS", "POS-RESPONSES", "NEG-RESPONSES")


class Param(NamedTuple):
    """One parameter of a message or structure: a constant, or a value of a data object."""

    name: str
    length: int  # bytes; 0 if it reaches to the end or is not known
    const: int | None = None
    dop: str = ""


def element(parent: Xml.Element, tag: str, text: object = None, **attributes: str) -> Xml.Element:
    """Add an element; ``_`` in attributes' names stands for ``-``."""
    named = {name.replace("_", "-"): value for name, value in attributes.items()}
    child = Xml.SubElement(parent, tag, named)
    if text is not None:
        child.text = str(text)
    return child


class Document:
    """The parts of one diagnostic layer."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._groups = {tag: Xml.Element(tag) for tag in (*_GROUPS, *_FIELDS, *_MESSAGES)}
        self._made: dict[object, str] = {}

    def dtcs(self, codes: Sequence[tuple[int, str, str]]) -> str:
        """Return the data object of codes: number, name, text of each."""
        dop = self._new("DTC-DOPS", "DTC-DOP", "dtc")
        _coded(dop, Field("dtc", 3))
        element(dop, "PHYSICAL-TYPE", BASE_DATA_TYPE="A_UINT32")
        _compu(dop, Field("dtc", 3))
        group = element(dop, "DTCS")
        for number, code, text in codes:
            dtc = element(group, "DTC", ID=f"{self.name}.DTC.{code}")
            element(dtc, "SHORT-NAME", code)
            element(dtc, "TROUBLE-CODE", number)
            element(dtc, "DISPLAY-TROUBLE-CODE", code)
            element(dtc, "TEXT", text)
        return dop.get("ID", "")

    def dop(self, field: Field) -> str:
        """Return the data object of a field; equal ones are one."""
        key = (field.kind, field.length, field.factor, field.offset)
        if key not in self._made:
            dop = self._new("DATA-OBJECT-PROPS", "DATA-OBJECT-PROP", f"dop_{len(self._made)}")
            _compu(dop, field)
            _coded(dop, field)
            is_scaled = (field.factor, field.offset) != (1.0, 0.0)
            kind = "A_FLOAT64" if is_scaled else _TYPES[field.kind][1]
            element(dop, "PHYSICAL-TYPE", BASE_DATA_TYPE=kind)
            self._made[key] = dop.get("ID", "")
        return self._made[key]

    def values(self, fields: Fields) -> list[Param]:
        """Return parameters for fields."""
        return [Param(f.name, f.length, dop=self.dop(f)) for f in fields]

    def structure(self, name: str, params: Sequence[Param]) -> str:
        """Return a structure."""
        made = self._new("STRUCTURES", "STRUCTURE", name)
        _params(made, params)
        return made.get("ID", "")

    def to_the_end(self, name: str, params: Sequence[Param]) -> Param:
        """Return a parameter with as many items as the message has room for."""
        field = self._new("END-OF-PDU-FIELDS", "END-OF-PDU-FIELD", name)
        element(field, "BASIC-STRUCTURE-REF", ID_REF=self.structure(f"{name}_item", params))
        return Param(name, TO_THE_END, dop=field.get("ID", ""))

    def counted(self, name: str, params: Sequence[Param]) -> Param:
        """Return a parameter with one byte that counts the items, and the items."""
        field = self._new("DYNAMIC-LENGTH-FIELDS", "DYNAMIC-LENGTH-FIELD", name)
        element(field, "BASIC-STRUCTURE-REF", ID_REF=self.structure(f"{name}_item", params))
        element(field, "OFFSET", 1)
        number = element(field, "DETERMINE-NUMBER-OF-ITEMS")
        element(number, "BYTE-POSITION", 0)
        element(number, "DATA-OBJECT-PROP-REF", ID_REF=self.dop(Field("count")))
        return Param(name, TO_THE_END, dop=field.get("ID", ""))

    def choice(self, name: str, length: int, cases: dict[int, Fields]) -> Param:
        """Return a parameter whose first bytes are a number that says which fields follow."""
        mux = self._new("MUXS", "MUX", name)
        element(mux, "BYTE-POSITION", length)
        key = element(mux, "SWITCH-KEY")
        element(key, "BYTE-POSITION", 0)
        element(key, "DATA-OBJECT-PROP-REF", ID_REF=self.dop(Field("key", length)))
        group = element(mux, "CASES")
        for number, fields in cases.items():
            case = element(group, "CASE")
            label = f"{name}_{number:0{2 * length}X}"
            element(case, "SHORT-NAME", label)
            element(case, "STRUCTURE-REF", ID_REF=self.structure(label, self.values(fields)))
            element(case, "LOWER-LIMIT", number)
            element(case, "UPPER-LIMIT", number)
        return Param(name, TO_THE_END, dop=mux.get("ID", ""))

    def service(self, name: str, request: Sequence[Param], response: Sequence[Param]) -> None:
        """Add a service with its request and its positive response."""
        service = self._new("DIAG-COMMS", "DIAG-SERVICE", name)
        for tag, group, kind, params in (
            ("REQUEST-REF", "REQUESTS", "REQUEST", request),
            ("POS-RESPONSE-REF", "POS-RESPONSES", "POS-RESPONSE", response),
        ):
            message = self._new(group, kind, name)
            _params(message, params)
            holder = service if kind == "REQUEST" else element(service, "POS-RESPONSE-REFS")
            element(holder, tag, ID_REF=message.get("ID", ""))
        refs = element(service, "NEG-RESPONSE-REFS")
        element(refs, "NEG-RESPONSE-REF", ID_REF=self._negative())

    def _negative(self) -> str:
        if "negative" not in self._made:
            message = self._new("NEG-RESPONSES", "NEG-RESPONSE", "negative")
            fields = Field("service"), Field("reason")
            _params(message, [Param("negative", 1, 0x7F), *self.values(fields)])
            self._made["negative"] = message.get("ID", "")
        return self._made["negative"]

    def _new(self, group: str, tag: str, name: str) -> Xml.Element:
        made = element(self._groups[group], tag, ID=f"{self.name}.{tag}.{name}")
        element(made, "SHORT-NAME", name)
        return made

    def text(self, version: str) -> bytes:
        """Return the document as XML."""
        Xml.register_namespace("xsi", _XSI)
        root = Xml.Element(
            "ODX", {"MODEL-VERSION": "2.2.0", f"{{{_XSI}}}noNamespaceSchemaLocation": "odx.xsd"}
        )
        container = element(root, "DIAG-LAYER-CONTAINER", ID=self.name)
        element(container, "SHORT-NAME", self.name)
        element(container, "DESC").append(_paragraph(f"o2-monitor {version}"))
        variants = element(container, "BASE-VARIANTS")
        variant = element(variants, "BASE-VARIANT", ID=f"{self.name}.BV")
        element(variant, "SHORT-NAME", self.name)
        dictionary = element(variant, "DIAG-DATA-DICTIONARY-SPEC")
        # the order of the schema
        order = (_GROUPS[0], _GROUPS[1], _GROUPS[2], _GROUPS[3], *_FIELDS)
        dictionary.extend(self._groups[tag] for tag in order if len(self._groups[tag]))
        variant.extend(self._groups[tag] for tag in _MESSAGES)
        Xml.indent(root)
        return bytes(Xml.tostring(root, "utf-8", xml_declaration=True))


def _paragraph(text: str) -> Xml.Element:
    made = Xml.Element("p")
    made.text = text
    return made


def _params(parent: Xml.Element, params: Sequence[Param]) -> None:
    group, position = element(parent, "PARAMS"), 0
    for param in params:
        kind = "VALUE" if param.const is None else "CODED-CONST"
        made = element(group, "PARAM")
        made.set(f"{{{_XSI}}}type", kind)
        element(made, "SHORT-NAME", param.name)
        element(made, "BYTE-POSITION", position)
        if param.const is None:
            element(made, "DOP-REF", ID_REF=param.dop)
        else:
            element(made, "CODED-VALUE", param.const)
            _coded(made, Field(param.name, param.length))
        position += param.length


def _coded(parent: Xml.Element, field: Field) -> None:
    coded = element(parent, "DIAG-CODED-TYPE", BASE_DATA_TYPE=_TYPES[field.kind][0])
    if field.length == TO_THE_END:
        coded.set(f"{{{_XSI}}}type", "MIN-MAX-LENGTH-TYPE")
        coded.set("TERMINATION", "END-OF-PDU")
        element(coded, "MIN-LENGTH", 0)
    else:
        coded.set(f"{{{_XSI}}}type", "STANDARD-LENGTH-TYPE")
        element(coded, "BIT-LENGTH", 8 * field.length)


def _compu(parent: Xml.Element, field: Field) -> None:
    method = element(parent, "COMPU-METHOD")
    if (field.factor, field.offset) == (1.0, 0.0):
        element(method, "CATEGORY", "IDENTICAL")
        return
    element(method, "CATEGORY", "LINEAR")
    scales = element(element(method, "COMPU-INTERNAL-TO-PHYS"), "COMPU-SCALES")
    ratio = element(element(scales, "COMPU-SCALE"), "COMPU-RATIONAL-COEFFS")
    numerator = element(ratio, "COMPU-NUMERATOR")
    element(numerator, "V", repr(field.offset))
    element(numerator, "V", repr(field.factor))
    element(element(ratio, "COMPU-DENOMINATOR"), "V", 1)
