"""The server's services as an ODX document, and the PDX file that holds it."""

import io
from typing import Final
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from monitor import __version__
from monitor.bus.diagnostics.reports import dtc_bytes
from monitor.bus.diagnostics.results import TESTS
from monitor.bus.odx import layout
from monitor.bus.odx.document import Document, Param
from monitor.bus.odx.layout import TO_THE_END, Field, Fields
from monitor.memory.codes import CODES, codes_of, every

NAME: Final = "o2_monitor"
_DATE: Final = (1980, 1, 1, 0, 0, 0)  # the same bytes in every run
_STATUS, _NUMBER = Field("status"), Field("number")
_AVAILABLE, _SEVERITY = Field("status_available"), Field("severity")
_GROUP, _FORMAT = Field("group"), Field("format")


def document() -> Document:
    """Return the description of all services."""
    made = Document(NAME)
    _Uds(made).add()
    _add_identifiers(made)
    _add_j1979(made)
    return made


def pdx() -> bytes:
    """Return the PDX file: the document and its index, the same bytes in every run."""
    buffer = io.BytesIO()
    with ZipFile(buffer, "w", ZIP_DEFLATED) as archive:
        for name, content in (
            (f"{NAME}.odx-d", document().text(__version__)),
            ("index.xml", _index(f"{NAME}.odx-d")),
        ):
            archive.writestr(ZipInfo(name, _DATE), content, ZIP_DEFLATED)
    return buffer.getvalue()


def _index(file: str) -> bytes:
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<CATALOG F-DTD-VERSION="ODX-2.2.0">
  <SHORT-NAME>{NAME}</SHORT-NAME>
  <ABLOCKS>
    <ABLOCK UPD="UNCHANGED">
      <SHORT-NAME>diagnostic_data</SHORT-NAME>
      <FILES>
        <FILE CREATION-DATE="1980-01-01T00:00:00" MIME-TYPE="application/x-asam.odx.odx-d">{file}</FILE>
      </FILES>
    </ABLOCK>
  </ABLOCKS>
</CATALOG>
""".encode()  # noqa: E501


class _Uds:
    """The services of ISO 14229-1 but 0x22."""

    def __init__(self, made: Document) -> None:
        self._made = made
        faults = {code: [f for f in CODES if code in codes_of(f)] for code in every()}
        numbers = {code: int.from_bytes(dtc_bytes(code), "big") for code in every()}
        self._dtc = Param(
            "dtc", 3, dop=made.dtcs([(numbers[c], c, ", ".join(faults[c])) for c in every()])
        )

    def _values(self, *fields: Field) -> list[Param]:
        return self._made.values(fields)

    def add(self) -> None:
        """Add the services."""
        made, values = self._made, self._values
        for name, session in (("default_session", 0x01), ("extended_session", 0x03)):
            timing = values(Field("p2_ms", 2), Field("p2_star_ms", 2, factor=10.0))
            made.service(name, _head(0x10, session), [*_head(0x50, session), *timing])
        made.service("tester_present", _head(0x3E, 0), _head(0x7E, 0))
        made.service("clear_codes", [*_head(0x14), *values(Field("group", 3))], _head(0x54))
        for level, seed_or_key in ((0x01, "seed"), (0x02, "key")):
            data = values(Field(seed_or_key, TO_THE_END, "bytes"))
            sent, back = ([], data) if level % 2 else (data, [])
            made.service(
                f"access_{seed_or_key}",
                [*_head(0x27, level), *sent],
                [*_head(0x67, level), *back],
            )
        self._add_reports()

    def _report(
        self, subfunction: int, name: str, request: list[Param], response: list[Param]
    ) -> None:
        self._made.service(
            f"report_{name}",
            [*_head(0x19, subfunction), *request],
            [*_head(0x59, subfunction), *response],
        )

    def _add_reports(self) -> None:
        made, values, dtc = self._made, self._values, self._dtc
        mask = values(Field("mask"))
        codes = made.to_the_end("codes", [dtc, *values(_STATUS)])
        listed = [*values(_AVAILABLE), codes]
        number = [*values(_AVAILABLE, _FORMAT, Field("count", 2))]
        self._report(0x01, "number_of_codes", mask, number)
        self._report(0x02, "codes_by_status", mask, listed)
        self._report(0x0A, "supported_codes", [], listed)
        self._report(0x15, "permanent_codes", [], listed)
        records = made.to_the_end("snapshot_numbers", [dtc, *values(_NUMBER)])
        self._report(0x03, "snapshot_numbers", [], [records])
        item = made.choice(
            "snapshot_value", 2, {0xF400 + pid: fields for pid, fields in layout.SIGNALS.items()}
        )
        snapshot = made.counted("snapshot_values", [item])
        snapshots = made.to_the_end("snapshots", [*values(_NUMBER), snapshot])
        chosen = [dtc, *values(_NUMBER)]
        self._report(0x04, "snapshot", chosen, [dtc, *values(_STATUS), snapshots])
        record = made.choice("extended", 1, layout.EXTENDED)
        extended = made.to_the_end("extended_records", [record])
        self._report(0x06, "extended_data", chosen, [dtc, *values(_STATUS), extended])
        counters = made.to_the_end("counters", [dtc, *values(Field("counter"))])
        self._report(0x14, "fault_detection_counters", [], [counters])
        with_record = [*values(_AVAILABLE, _NUMBER), codes]
        self._report(0x1A, "codes_with_record", values(_NUMBER), with_record)
        severe = made.to_the_end("severe_codes", [*values(_SEVERITY), dtc, *values(_STATUS)])
        self._report(
            0x42,
            "obd_codes",
            values(_GROUP, Field("mask"), _SEVERITY),
            [*values(_GROUP, _AVAILABLE, Field("severity_available"), _FORMAT), severe],
        )
        group = values(_GROUP, _AVAILABLE, _FORMAT)
        self._report(0x55, "obd_permanent_codes", values(_GROUP), [*group, codes])
        readiness = Field("readiness_group")
        self._report(
            0x56,
            "obd_readiness_codes",
            values(_GROUP, readiness),
            [*group, *values(readiness), codes],
        )


def _add_identifiers(made: Document) -> None:
    """Add a service of 0x22 for every identifier."""
    described = dict(layout.IDENTIFIERS)
    for high, table in (
        (0xF400, layout.SIGNALS | layout.CURRENT),
        (0xF500, {}),
        (0xF800, layout.INFORMATION | {0x10: layout.PROTOCOL}),
    ):
        described |= {high + low: layout.SUPPORTED for low in range(0x00, 0x100, 0x20)}
        described |= {high + low: fields for low, fields in table.items()}
    for number, fields in described.items():
        _add_read(made, number, made.values(fields))
    for low in range(0x00, 0x100, 0x20):
        if low not in TESTS:
            _add_read(made, 0xF600 + low, made.values(layout.SUPPORTED))
    results = made.to_the_end("results", made.values(layout.RESULT))
    for monitor in TESTS:
        _add_read(made, 0xF600 + monitor, [results])


def _add_read(made: Document, number: int, data: list[Param]) -> None:
    identifier = Param("identifier", 2, number)
    made.service(
        f"read_{number:04X}", [*_head(0x22), identifier], [*_head(0x62), identifier, *data]
    )


def _add_j1979(made: Document) -> None:
    """Add the services of SAE J1979, with one number per request."""
    maps = dict.fromkeys(range(0, 256, 32), layout.SUPPORTED)

    def add(service: int, number: int, data: Fields, *, frame: bool = False) -> None:
        part = [Param("parameter", 1, number), *([Param("frame", 1, 0)] if frame else [])]
        name = f"obd_{service:02X}_{number:02X}"
        response = [*_head(service + 0x40), *part, *made.values(data)]
        made.service(name, [*_head(service), *part], response)

    for number, data in (maps | layout.CURRENT).items():
        add(0x01, number, data)
    for number, data in (maps | {0x02: (Field("code", 2, "bytes"),)} | layout.SIGNALS).items():
        add(0x02, number, data, frame=True)
    for number, data in layout.INFORMATION.items():
        add(0x09, number, (Field("count"), *data))
    add(0x09, 0x00, layout.SUPPORTED)
    rows = made.to_the_end("rows", made.values((Field("monitor"), *layout.RESULT)))
    for number, data in maps.items():
        if number not in TESTS:
            add(0x06, number, data)
    for number in TESTS:
        # the response repeats the monitor before each test
        request = [*_head(0x06), Param("monitor", 1, number)]
        made.service(f"obd_06_{number:02X}", request, [*_head(0x46), rows])
    codes = made.to_the_end("obd_codes", made.values((Field("code", 2, "bytes"),)))
    for service in (0x03, 0x07, 0x0A):
        count = made.values((Field("count"),))
        made.service(f"obd_{service:02X}", _head(service), [*_head(service + 0x40), *count, codes])
    made.service("obd_04", _head(0x04), _head(0x44))


def _head(service: int, subfunction: int | None = None) -> list[Param]:
    """Return the constants at the start of a message."""
    sid = Param("service_id", 1, service)
    return [sid] if subfunction is None else [sid, Param("subfunction", 1, subfunction)]
