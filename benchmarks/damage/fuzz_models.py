"""Load damaged and hostile model files: each is refused in one line, in time and memory bounds.

python -m benchmarks fuzz_models [--cases 10000]
"""

import hashlib
import json
import random
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from benchmarks.damage.harness import Outcomes, fuzz_options
from benchmarks.measures import peak_mb
from benchmarks.outcome import finish, say
from monitor.base.errors import ModelError
from monitor.model import model_file
from monitor.model.card import ModelCard
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model


def with_card_text(content: bytes, text: str | bytes, *, signed: bool = True) -> bytes:
    """Return a model file with another card and its right checksum, or without one."""
    model = onnx.load_from_string(content)
    model.ClearField("metadata_props")
    raw = text.encode() if isinstance(text, str) else text
    marked = b"CARD" * (len(raw) // 4 + 1)
    stand_in = marked[: len(raw)].decode()
    entries = {model_file.CARD: stand_in}
    if signed:
        entries[model_file.CARD_SHA256] = hashlib.sha256(raw).hexdigest()
    helper.set_model_props(model, entries)
    return bytes(model.SerializeToString().replace(stand_in.encode(), raw))


def with_card(content: bytes, changes: Mapping[str, Any]) -> bytes:
    """Return a model file whose card has other values; the keys may be paths with dots."""
    card = json.loads(card_of(content))
    for key, value in changes.items():
        at, *names = card, *key.split(".")
        for name in names[:-1]:
            at = at[int(name)] if isinstance(at, list) else at[name]
        at[int(names[-1]) if isinstance(at, list) else names[-1]] = value
    return with_card_text(content, json.dumps(card))


def with_graph(content: bytes, change: Callable[[onnx.ModelProto], None]) -> bytes:
    """Return a model file with another graph and the right checksums."""
    model = onnx.load_from_string(content)
    card = ModelCard.from_json(card_of(content))
    change(model)
    model.ClearField("metadata_props")
    digest = hashlib.sha256(model.SerializeToString()).hexdigest()
    text = json.dumps(json.loads(card.to_json()) | {"graph_sha256": digest})
    helper.set_model_props(model, model_file.metadata_of(text))
    return bytes(model.SerializeToString())


def hostile(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield files that ask for more than a model may have, or hold what no model has."""
    yield from _hostile_graphs(content)
    yield from _hostile_cards(content)
    yield "empty", b""
    yield "nine megabytes", content + b"\0" * 9_000_000
    yield "many parts", b"\x08\x08" * 3_000_000
    yield "many strings", content + b"\x32\x00" * 1_000_000
    yield "a metadata of megabytes", with_card_text(content, '"' + "x" * 5_000_000 + '"')
    yield "two graphs", content + content
    yield "a library", content + b"\xca\x01\x02\x0a\x00"


def _hostile_graphs(content: bytes) -> Iterator[tuple[str, bytes]]:
    weight = "w0"

    def weights(model: onnx.ModelProto, value: float) -> None:
        (at,) = [i for i, each in enumerate(model.graph.initializer) if each.name == weight]
        array = numpy_helper.to_array(model.graph.initializer[at]).copy()
        array[0, 0] = value
        model.graph.initializer[at].CopyFrom(numpy_helper.from_array(array, weight))

    def outer(model: onnx.ModelProto) -> None:
        for name, shape in (("column", (90_000, 1)), ("row", (1, 90_000))):
            zeros = np.zeros(shape, np.float32)
            model.graph.initializer.append(numpy_helper.from_array(zeros, name))
        model.graph.node.append(helper.make_node("Add", ["column", "row"], ["square"]))

    def doubled(model: onnx.ModelProto) -> None:
        last = "b0"
        for i in range(60):
            model.graph.node.append(helper.make_node("Concat", [last, last], [f"d{i}"], axis=0))
            last = f"d{i}"

    def filled(model: onnx.ModelProto) -> None:
        size = np.array([10**9, 10**9])
        model.graph.initializer.append(numpy_helper.from_array(size, "size"))
        model.graph.node.append(helper.make_node("ConstantOfShape", ["size"], ["filled"]))

    def endless(model: onnx.ModelProto) -> None:
        body = helper.make_graph([], "body", [], [])
        model.graph.node.append(helper.make_node("Loop", ["", ""], [], body=body))

    def outside(model: onnx.ModelProto) -> None:
        tensor = TensorProto(name="x", data_type=1, dims=[4], data_location=1)
        entry = tensor.external_data.add()
        entry.key, entry.value = "location", "/etc/passwd"
        model.graph.initializer.append(tensor)

    def wide(model: onnx.ModelProto) -> None:
        model.graph.initializer.append(TensorProto(name="x", data_type=1, dims=[10**12]))

    for value in (np.nan, np.inf, -np.inf):
        yield f"weight {value}", with_graph(content, lambda m, v=value: weights(m, v))
    for change in (outer, doubled, filled, endless, outside, wide):
        yield change.__name__, with_graph(content, change)


def _hostile_cards(content: bytes) -> Iterator[tuple[str, bytes]]:
    yield "deep JSON", with_card_text(content, "[" * 200_000)
    yield "deep object", with_card_text(content, '{"a":' * 100_000)
    yield "no UTF-8", with_card_text(content, b'{"schema": "\xff\xfe\x80"}')
    yield "NaN", with_card(content, {"residual_std": float("nan")})
    yield "infinite limit", with_card(content, {"limits.noise.value": float("inf")})
    numbers = ("infinite mean", "residual_mean", "1e999"), ("huge integer", "period_ns", "9" * 5000)
    for name, key, number in numbers:
        text = card_of(content).replace(f'"{key}": ', f'"{key}": {number}, "x": ')
        yield name, with_card_text(content, text)
    for key, value in (
        *(("period_ns", each) for each in (0, 1, 1000, 10**300, -5, 1e8, "1", None, True)),
        *zip(["lags"] * 5, (0, 10**12, -1, [], 1.5), strict=True),
        ("state.size", 10**15),
        ("state.output_step", 0),
        ("state.output_start", -(10**12)),
        ("limits.noise.value", 10**400),
        ("output_limits", [10**400, 1]),
        ("output_limits", [float("-inf"), 1.0]),
        ("residual_std", -1.0),
        ("inputs", []),
        ("inputs", {"a": 1}),
        ("inputs.0.minimum", float("nan")),
        ("layers", ["x"]),
        ("limits", [1, 2]),
        ("structure", 5),
        ("kind", None),
        ("window_samples", 10**9),
        ("graph_sha256", 5),
        ("schema", ["o2_monitor.card/1"] * 1000),
    ):
        yield f"{key} {str(value)[:20]}", with_card(content, {key: value})


def damaged(content: bytes, draw: random.Random) -> bytes:
    """Return a file with flipped bits, cut off, or with a part overwritten, doubled or removed."""
    kind, changed = draw.randrange(6), bytearray(content)
    at = draw.randrange(len(content))
    if kind == 0:
        return content[:at]
    if kind == 1:
        changed[at : at + 20] = draw.randbytes(len(changed[at : at + 20]))
    elif kind == 2:
        changed[at:at] = changed[at : at + draw.randrange(200)]
    elif kind == 3:
        del changed[at : at + draw.randrange(1, 50)]
    else:
        for _ in range(draw.choice([1, 1, 1, 4])):
            changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def outcome(content: bytes, good: bytes, path: Path) -> str:
    """Return what became of a damaged file: refused, untouched, or in capitals an error."""
    if content == good:
        return "untouched"
    path.write_bytes(content)
    try:
        model = Model.load(path)
    except ModelError as error:
        said = str(error)
        if str(path) not in said or "\n" in said or len(said) > len(str(path)) + 400:
            return f"BAD MESSAGE {said[:200]}"
        return "refused"
    except BaseException as error:
        return f"FATAL {type(error).__name__}: {str(error)[:200]}"
    found = onnx.load_from_string(content)
    if model.card.to_json() == card_of(good) and graph_of(found) == graph_of(
        onnx.load_from_string(good)
    ):
        return "harmless"  # only metadata that nobody reads has changed
    return "SILENT"


def graph_of(model: onnx.ModelProto) -> bytes:
    """Return all of a model but its metadata."""
    model.ClearField("metadata_props")
    return bytes(model.SerializeToString())


def card_of(content: bytes) -> str:
    """Return the card of a good file."""
    (card,) = (
        each.value
        for each in onnx.load_from_string(content).metadata_props
        if each.key == model_file.CARD
    )
    return str(card)


SLOW_S = 5.0
LARGE_MB = 500.0


def main(argv: Sequence[str]) -> int:
    """Count the outcomes; return 1 if one of them is an error."""
    args = fuzz_options(__name__, __doc__, 10_000, 400).parse_args(argv)
    draw, good = random.Random(args.seed), shipped_model().read_bytes()
    outcomes = Outcomes()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        files = [(f"damage {i}", damaged(good, draw)) for i in range(args.cases)]
        before_mb = peak_mb()
        for name, content in [*files, *hostile(good)]:
            found = outcomes.add(name, lambda c=content: outcome(c, good, path))
            if found != "refused" and not name.startswith("damage"):
                say(f"{name}: {found}")
        more_mb = peak_mb() - before_mb
    missed = outcomes.missed(SLOW_S) + [f"{LARGE_MB:g} MB"] * (more_mb > LARGE_MB)
    return finish(args, [*outcomes.rows(), {"more_memory_mb": more_mb}], missed)
