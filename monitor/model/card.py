"""The model card: kind of model, training recordings, fit measures and limits.

It is JSON in the ONNX file's metadata under ``o2_monitor_card``. A missing or unknown key, or a
value of the wrong type, is a ModelError that names the file.
"""

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar, cast, get_args, get_origin, get_type_hints

from monitor.base.errors import ModelError

T = TypeVar("T")

SCHEMA = "o2_monitor.card/1"
WINDOW_SAMPLES = 50  # Model Based Diagnosis of Oxygen Sensors, section 2
MEMORY_MOST = 100_000  # samples after which a model forgets its history
# field → least and largest value
RANGES: Final = {
    "period_ns": (1_000_000, 3_600_000_000_000),  # 1 ms to 1 h
    "lags": (1, 100_000),
    "input_lag_start": (0, 100_000),
    "window_samples": (2, 100_000),
}
SHOWN: Final = 60  # characters of a wrong value in a message
_CARD: Final = "model card"
_GONE: Final = ("fuel_cut", "region")  # fields that older cards have
USUAL_PREDICTION: Final = "lambda_hat"  # the graph's output in models of any output, once


def prediction_name(output: str) -> str:
    """Return the name that the graph's prediction has for an output of the model.

    >>> prediction_name("lambda_measured"), prediction_name("level_m")
    ('lambda_hat', 'level_m_hat')
    """
    return output.removesuffix("_measured") + "_hat"


@dataclass(frozen=True, slots=True)
class Channel:
    """One input or the output, with its unit and its range in training, in that unit."""

    name: str
    unit: str
    minimum: float
    maximum: float
    percentile_0_1: float
    percentile_99_9: float


@dataclass(frozen=True, slots=True)
class StateLayout:
    """Places of past outputs in ``state``, newest first, in model units (phi or output).

    A NARX holds as many past outputs as lags; a greybox holds one, beside its own state variables.
    """

    size: int
    output_start: int
    output_step: int
    output_count: int

    @property
    def output_slice(self) -> slice:
        """The output history as a slice of the last axis of ``state``.

        >>> StateLayout(size=6, output_start=1, output_step=2, output_count=3).output_slice
        slice(1, 6, 2)
        """
        stop = self.output_start + self.output_step * (self.output_count - 1) + 1
        return slice(self.output_start, stop, self.output_step)


@dataclass(frozen=True, slots=True)
class TrainingRecording:
    """A recording used in training."""

    path: str  # file name without folders, because models move between machines
    sha256: str
    samples: int
    source: str = ""  # "simulated", or "" if no manifest names its source


@dataclass(frozen=True, slots=True)
class Limit:
    """One decision limit and its origin."""

    value: float
    unit: str
    origin: str


@dataclass(frozen=True, slots=True)
class ModelCard:
    """All that is known of a model beside its graph."""

    kind: str  # "narx", "greybox"
    inputs: tuple[Channel, ...]
    output: Channel
    transform: str  # "phi": the model works on 1/output; "none"
    output_limits: tuple[float, float]  # predictions are clipped to this range, in model units
    period_ns: int
    lags: int  # NARX: longest lag of inputs and output; greybox: samples to fill it at steady input
    input_lag_start: int
    layers: tuple[int, ...]  # neurons per hidden layer; empty for a greybox
    state: StateLayout
    recordings: tuple[TrainingRecording, ...]
    residual_mean: float  # healthy vehicle, enabled samples, in the output's unit
    residual_std: float
    window_samples: int = WINDOW_SAMPLES
    transforms: tuple[Mapping[str, Any], ...] = ()  # of inputs, inside the graph
    effects: tuple[Mapping[str, Any], ...] = ()  # added by the gap workflow
    structure: Mapping[str, Any] = field(default_factory=dict)  # form of the lags, by kind
    fit: Mapping[str, Any] = field(default_factory=dict)  # fit measures on held-out samples
    checks: Mapping[str, Any] = field(default_factory=dict)  # contraction, work of the training
    limits: Mapping[str, Limit] = field(default_factory=dict)
    reference: Mapping[str, Any] = field(default_factory=dict)  # healthy reference of this vehicle
    packages: Mapping[str, str] = field(default_factory=dict)
    # the logger's profile that was given to the fit, as its TOML tree; {} in older cards
    profile: Mapping[str, Any] = field(default_factory=dict)
    # what the model finds and mistakes on drives that it has not seen; {} in older cards
    trust: Mapping[str, Any] = field(default_factory=dict)
    # how often each input's and the output's values change, and how far they are apart
    times: Mapping[str, Any] = field(default_factory=dict)  # {} in older cards
    # of all parts of the file but its metadata, entered by the writer; "" in older cards
    graph_sha256: str = field(default="", compare=False)
    schema: str = SCHEMA

    @property
    def input_names(self) -> tuple[str, ...]:
        """Return the names of the inputs in the order of ``u``."""
        return tuple(channel.name for channel in self.inputs)

    @property
    def memory_samples(self) -> int:
        """Return the samples after which the model must forget its history, 0 if not said."""
        return int(self.checks.get("contraction", {}).get("samples", 0))

    def to_json(self) -> str:
        """Return the card as JSON, with the keys in the order of the fields.

        Raises ValueError if a number is not finite.
        """
        return json.dumps(dataclasses.asdict(self), indent=1, allow_nan=False)

    @classmethod
    def from_json(cls, text: str, path: str = "model card") -> "ModelCard":
        """Return the card from JSON.

        path : name of the file, for errors
        Raises ModelError if ``text`` is no card of this schema.
        """
        try:
            data = json.loads(text, parse_constant=_refused, parse_float=_finite)
        except (ValueError, RecursionError) as error:
            raise ModelError(f"{path}: the model card is not JSON: {error}") from None
        if not isinstance(data, dict):
            raise ModelError(f"{path}: the model card is a {type(data).__name__}, not an object")
        if data.get("schema") != SCHEMA:
            raise ModelError(
                f"{path}: the model card has schema {_shown(data.get('schema'))}, wanted {SCHEMA!r}"
            )
        return _card(data, path)


def _card(data: dict[str, Any], path: str) -> ModelCard:
    older: dict[str, Any] = {name: {} for name in ("structure", "profile", "trust", "times")}
    older |= {"graph_sha256": ""}
    data = older | {name: each for name, each in data.items() if name not in _GONE}
    try:
        card = _part(ModelCard, data, path, _CARD)
        card = dataclasses.replace(card, times=_times(card.times))
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ModelError(f"{path}: the model card has a value of the wrong type: {error}") from None
    for problem in _problems(card):
        raise ModelError(f"{path}: {problem}")
    return card


def _times(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the times of columns; raises ValueError, TypeError or AttributeError."""
    if not given:
        return {}
    every = {str(name): float(s) for name, s in given.get("every_s", {}).items()}
    apart = {
        str(pair): (float(low), float(high))
        for pair, (low, high) in given.get("apart_s", {}).items()
    }
    return {"every_s": every, "apart_s": apart}


def _refused(constant: str) -> Any:
    raise ValueError(f"it holds {constant}, which is no number")


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ValueError(f"it holds {text[:20]}, which is no finite number")
    return float(text)


def _shown(value: Any) -> str:
    """Return a value for a message, which stays one line."""
    try:
        said = repr(value)
    except ValueError:  # a whole number of thousands of digits
        said = f"a {type(value).__name__}"
    return _short(said)


def _short(said: str) -> str:
    return said if len(said) <= SHOWN else f"{said[:SHOWN]}…"


def _keys(data: Mapping[str, Any], kind: type, path: str, where: str) -> None:
    names = {f.name for f in dataclasses.fields(kind)}
    for word, keys in (("lacks", names - data.keys()), ("has unknown", data.keys() - names)):
        if keys:
            raise ModelError(f"{path}: {where} {word} {_short(', '.join(sorted(keys)))}")


def _part(kind: type[T], data: Any, path: str, where: str) -> T:
    """Return a dataclass; check the JSON's types."""
    if not isinstance(data, dict):
        raise ModelError(f"{path}: {where} holds {_shown(data)}, wanted an object")
    _keys(data, kind, path, where)
    inside = "" if where == _CARD else f"{where}."
    hints = get_type_hints(kind)
    return kind(**{k: _value(hints[k], each, path, f"{inside}{k}") for k, each in data.items()})


def _value(kind: Any, value: Any, path: str, where: str) -> Any:
    """Return a value of JSON as one of a type: a number, a text, a dataclass, or several."""
    origin, parts = get_origin(kind), get_args(kind)
    if dataclasses.is_dataclass(kind):
        return _part(cast("type[Any]", kind), value, path, where)
    if origin is Mapping and isinstance(value, dict):
        return {k: _value(parts[1], each, path, f"{where}.{k}") for k, each in value.items()}
    if origin is tuple and isinstance(value, list):
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        if len(kinds) == len(value):
            pairs = zip(kinds, value, strict=True)
            return tuple(_value(own, each, path, where) for own, each in pairs)
    if kind is float and type(value) is int:
        value = float(value)  # OverflowError for one that no float holds
    if kind is not Any and type(value) is not kind:
        wanted = {tuple: "a list", Mapping: "an object"}.get(origin) or kind.__name__
        raise ModelError(f"{path}: {where} is {_shown(value)}, wanted {wanted}")
    return value


def _problems(card: ModelCard) -> Iterator[str]:
    """Yield in words which values contradict each other or exceed a bound."""
    for name, (least, most) in RANGES.items():
        if not least <= getattr(card, name) <= most:
            yield f"{name} is {_shown(getattr(card, name))}, wanted {least} to {most}"
    contraction = card.checks.get("contraction", {})
    is_object = isinstance(contraction, dict)
    samples = contraction.get("samples", 0) if is_object else contraction
    if not is_object or type(samples) is not int or not 0 <= samples <= MEMORY_MOST:
        yield f"checks.contraction has {_shown(samples)}, wanted samples from 0 to {MEMORY_MOST}"
    if card.residual_std < 0.0:
        yield f"residual_std is {card.residual_std}, wanted 0 or more"
    if card.transform not in ("phi", "none"):
        yield f"transform is {_shown(card.transform)}, wanted 'phi' or 'none'"
    if not card.inputs:
        yield "the model card has no inputs"
    if not card.output_limits[0] < card.output_limits[1]:
        yield f"output_limits are {card.output_limits}, wanted low < high"
    if len({*card.input_names, card.output.name}) <= len(card.inputs):
        yield f"inputs {[*card.input_names]} and output must differ"
    if card.transform == "phi" and not card.output.name.startswith("lambda"):
        yield f"transform 'phi' is for lambda, not {card.output.name}"
    for name, limit in card.limits.items():
        if limit.value < 0.0 or (name == "noise" and limit.value == 0.0):
            yield f"limit {name} is {limit.value}, wanted a positive number"
    yield from _problems_of_state(card)


def _problems_of_state(card: ModelCard) -> Iterator[str]:
    layout = card.state
    if card.kind == "narx" and layout.output_count != card.lags:
        yield f"the state holds {layout.output_count} outputs, the lags are {card.lags}"
    if layout.output_step < 1 or layout.output_count < 1:
        yield f"the output history {layout} is empty"
    elif not 0 <= layout.output_start < layout.output_slice.stop <= layout.size:
        yield f"the output history {layout} lies outside the state"
