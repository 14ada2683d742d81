"""The content of a fault memory, and its text in a file: one JSON document."""

import json
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import Saved
from monitor.memory.obd_records import Counts, FreezeFrame, Ratio, TestResult
from monitor.memory.reference import Reference

SCHEMA_VERSION: Final = 5


@dataclass(frozen=True, slots=True)
class Content:
    """A fault memory: what is saved, and which of its states it is."""

    saved: Saved = field(default_factory=Saved)
    references: Mapping[str, Reference] = field(default_factory=dict)  # by the model's sha256
    memory: str = field(default_factory=lambda: secrets.token_hex(8))  # copies of it share this
    generation: int = 0  # counts the times that the memory was stored
    set_aside: str = ""  # file of the lost memory before this one, until its loss is a stored code


def text_of(content: Content) -> str:
    """Return the text of a content, without line breaks."""
    return json.dumps({"schema": SCHEMA_VERSION, "content": content}, default=_plain)


def _plain(value: Any) -> Any:
    """Return a dataclass, set or number of numpy as JSON has it."""
    if hasattr(value, "__slots__"):
        return {name: getattr(value, name) for name in value.__slots__}
    return sorted(value) if isinstance(value, frozenset) else float(value)


def content_of(text: bytes) -> Content:
    """Return the content of a text; raises ValueError, TypeError or KeyError if it is another's."""
    document = json.loads(text)
    if document["schema"] != SCHEMA_VERSION:
        raise ValueError(f"schema {document['schema']}, wanted {SCHEMA_VERSION}")
    content = document["content"]
    references = {model: Reference(**each) for model, each in content["references"].items()}
    return Content(**content | {"saved": _saved_of(content["saved"]), "references": references})


def _saved_of(fields: dict[str, Any]) -> Saved:
    fields.pop("latest_frames", None)  # of older memories
    made = {name: tuple(make(**each) for each in fields[name]) for name, make in _RECORDS.items()}
    others = {"counts": Counts(**fields["counts"]), "completed": frozenset(fields["completed"])}
    return Saved(**fields | made | others)


def _dtc(also: list[str], status: int, **others: Any) -> Dtc:
    return Dtc(also=tuple(also), status=Status(status), **others)


_RECORDS: Final[dict[str, Callable[..., Any]]] = {
    "dtcs": _dtc,
    "freeze_frames": FreezeFrame,
    "results": TestResult,
    "ratios": Ratio,
}
