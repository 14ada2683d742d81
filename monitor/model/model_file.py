"""A model file as bytes: its graph, its card, and the checksums of both.

The card holds the sha256 of the graph, and the file the sha256 of the card. So a bit that changed
shows, wherever it stands. What a file may hold is bounded here before any library reads it.
"""

import hashlib
from pathlib import Path
from typing import Final, NamedTuple

from monitor.base.errors import ModelError
from monitor.model.graph_bounds import StepGraph, graph_of
from monitor.model.protobuf import Field, Parts, content, text

CARD: Final = "o2_monitor_card"  # keys of the ONNX metadata
CARD_SHA256: Final = "o2_monitor_card_sha256"
LARGEST_FILE: Final = 8_000_000  # bytes; a network of 64 × 64 neurons has 100,000
LARGEST_CARD: Final = 2_000_000  # bytes
MOST_PARTS: Final = 100_000  # fields of protobuf; a chain with all effects has 20,000
# fields of ModelProto: ir_version, producer_name and _version, domain, model_version, doc_string,
# graph, opset_import, metadata_props
_GRAPH: Final = 7
_METADATA: Final = 14
_KNOWN: Final = frozenset({1, 2, 3, 4, 5, 6, _GRAPH, 8, _METADATA})


class ModelFile(NamedTuple):
    """A model file whose contents are allowed."""

    content: bytes
    card: str  # JSON
    is_signed: bool  # the card's sha256 stands beside it; older files lack it
    graph: StepGraph
    graph_sha256: str  # of all fields but the metadata


def read(path: Path | str) -> ModelFile:
    """Return a model file; raises ModelError if it is none, is damaged or exceeds a bound."""
    try:
        if not Path(path).is_file():
            raise ModelError(f"{path}: no such model file")
        with Path(path).open("rb") as file:
            found = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from None
    if len(found) > LARGEST_FILE:
        raise ModelError(
            f"{path}: not a model file: larger than {LARGEST_FILE // 10**6} MB, a model has kB"
        )
    try:
        metadata, graph, graph_sha256 = _parts(found)
    except ValueError as error:
        raise ModelError(f"{path}: not a usable ONNX file: {error}") from None
    if CARD not in metadata:
        raise ModelError(f"{path}: no model card (metadata {CARD!r}) in this ONNX file")
    card = metadata[CARD]
    if len(card) > LARGEST_CARD:
        raise ModelError(f"{path}: the model card has {len(card)} bytes, at most {LARGEST_CARD}")
    own = metadata.get(CARD_SHA256)
    if own is not None and own.decode(errors="replace") != hashlib.sha256(card).hexdigest():
        raise ModelError(f"{path}: the model card was changed or damaged: its sha256 is another")
    try:
        return ModelFile(found, card.decode(), own is not None, graph, graph_sha256)
    except UnicodeDecodeError:
        raise ModelError(f"{path}: the model card is no UTF-8 text") from None


def _parts(found: bytes) -> tuple[dict[str, bytes], StepGraph, str]:
    """Return the metadata, the graph, and the sha256 of all but the metadata; raises ValueError."""
    parts, digest = Parts(MOST_PARTS), hashlib.sha256()
    metadata, graphs = dict[str, bytes](), list[StepGraph]()
    for field in parts.fields(memoryview(found)):
        if field.number not in _KNOWN:
            raise ValueError(f"it has a part that no model has (field {field.number})")
        if field.number == _METADATA:
            key, value = _entry(field, parts)
            if key in metadata:
                raise ValueError(f"it has the metadata {key!r} twice")
            metadata[key] = value
            continue
        digest.update(field.raw)
        if field.number == _GRAPH:
            graphs.append(graph_of(content(field), parts))
    if len(graphs) != 1:
        raise ValueError(f"it has {len(graphs)} graphs, one is wanted")
    return metadata, graphs[0], digest.hexdigest()


def _entry(field: Field, parts: Parts) -> tuple[str, bytes]:
    key, value = "", b""
    for each in parts.fields(content(field)):
        if each.number == 1:
            key = text(each)
        elif each.number == 2:
            value = bytes(content(each))
    return key, value


def graph_sha256(model: bytes) -> str:
    """Return the sha256 of the graph of a model file's content; raises ValueError."""
    return _parts(model)[2]


def metadata_of(card: str) -> dict[str, str]:
    """Return the metadata of a file with this card."""
    return {CARD: card, CARD_SHA256: hashlib.sha256(card.encode()).hexdigest()}
