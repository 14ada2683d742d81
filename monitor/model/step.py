"""Step 5: one closed-loop step of the model, which keeps its state.

The ONNX graph ``step`` maps inputs in physical units and a state to the prediction and the next
state; scaling, clipping and added effects are inside the graph. Input and output memory is bound
once, and the state alternates between two buffers, so a step allocates nothing.
"""

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray, Shown
from monitor.model import model_file
from monitor.model.card import USUAL_PREDICTION, ModelCard, prediction_name

Float32Array = NDArray[np.float32]
Inputs = NDArray[np.float32] | NDArray[np.float64]
LAMBDA_MAX = 16.0  # reading of a UEGO in air; smaller phi than 1/16 reads the same
PHI_MAX = 1.7


def to_model_units(transform: str, output: FloatArray | float) -> FloatArray:
    """Return phi = 1/lambda in 0 .. 1.7 for "phi", otherwise ``output``; NaN stays NaN.

    >>> to_model_units("phi", np.array([0.8, 2.0, np.inf])).tolist()
    [1.25, 0.5, 0.0]
    """
    value = np.asarray(output, dtype=np.float64)
    if transform == "none":
        return value
    return np.asarray(np.clip(1.0 / np.maximum(value, 1e-3), 0.0, PHI_MAX))


def from_model_units(transform: str, value: FloatArray | float) -> FloatArray:
    """Return lambda = 1/phi, at most 16, for "phi", otherwise ``value``.

    >>> from_model_units("phi", np.array([1.25, 0.0])).tolist()
    [0.8, 16.0]
    """
    value = np.asarray(value, dtype=np.float64)
    if transform == "none":
        return value
    return np.asarray(1.0 / np.maximum(value, 1.0 / LAMBDA_MAX))


class _Binding:
    """One binding of the session: it reads one state buffer and writes the other."""

    def __init__(
        self,
        session: ort.InferenceSession,
        u: Float32Array,
        state: Float32Array,
        predicted: tuple[str, Float32Array],
        next_state: Float32Array,
    ) -> None:
        self.binding = session.io_binding()
        for name, array in (("u", u), ("state", state)):
            self.binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        for name, array in (predicted, ("next_state", next_state)):
            self.binding.bind_output(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        self.next_state = next_state


class Model(Shown):
    """The model on ``batch`` vehicles side by side, one by default.

    Inputs must be finite; the caller replaces stale and invalid signals.
    """

    def __init__(
        self,
        session: ort.InferenceSession,
        card: ModelCard,
        batch: int = 1,
        *,
        path: Path = Path(),
        sha256: str = "",
    ) -> None:
        self.card, self._session, self.batch = card, session, batch
        self.path, self.sha256 = path, sha256  # of the file
        self.n_inputs = len(card.inputs)
        self._u = np.zeros((batch, self.n_inputs), np.float32)
        self._predicted = np.zeros((batch, 1), np.float32)
        even, odd = (np.zeros((batch, card.state.size), np.float32) for _ in range(2))
        self._bindings = tuple(
            _Binding(session, self._u, a, (_prediction(session, card), self._predicted), b)
            for a, b in ((even, odd), (odd, even))
        )
        self._state, self._turn = even, 0
        self._run: Any = session.run_with_iobinding

    @classmethod
    def load(cls, path: Path | str, batch: int = 1) -> "Model":
        """Return the model of an ONNX file.

        Raises ModelError if the file is not ONNX, has no card, exceeds a bound, or if card and
        graph disagree. Cards of older models do not say the graph's sha256; they are taken.
        """
        file = model_file.read(path)
        card = ModelCard.from_json(file.card, str(path))
        if bool(card.graph_sha256) != file.is_signed:  # older files have neither
            raise ModelError(f"{path}: of the checksums of graph and card one is missing")
        if file.is_signed and card.graph_sha256 != file.graph_sha256:
            raise ModelError(
                f"{path}: the graph was changed or damaged: its sha256 is not the one in its card "
                f"({file.graph_sha256[:12]}…, wanted {card.graph_sha256[:12]}…)"
            )
        session = open_session(file.content, str(path))
        check_graph(session, card, str(path))
        sha256 = hashlib.sha256(file.content).hexdigest()
        return cls(session, card, batch, path=Path(path), sha256=sha256)

    def with_batch(self, batch: int) -> "Model":
        """Return the same model with a new state for ``batch`` vehicles."""
        return Model(self._session, self.card, batch, path=self.path, sha256=self.sha256)

    @property
    def facts(self) -> dict[str, object]:
        """Return file, kind, inputs, output and period."""
        card, inputs = self.card, " ".join(self.card.input_names)
        told = {"output": card.output.name, "period": f"{card.period_ns / 1e9:g} s"}
        return {"file": self.path, "kind": card.kind, "inputs": inputs} | told

    @property
    def state(self) -> Float32Array:
        """Return the current state, shape (batch, n_state); the array is live."""
        return self._state

    def step(self, u: FloatArray) -> float:
        """Return the prediction for one tick, in the output's unit.

        u : shape (n_inputs,)
        Raises ValueError if an input is not finite.
        """
        return self.step_batch(np.asarray(u)[np.newaxis]).item()

    def step_batch(self, u: Inputs) -> Float32Array:
        """Return the predictions for one tick, shape (batch,), in the output's unit.

        u : shape (batch, n_inputs)
        Raises ValueError if an input is not finite.
        """
        self._u[:] = u
        self._check_finite(self._u)
        self._advance()
        return self._predicted[:, 0].copy()

    def _check_finite(self, u: Float32Array) -> None:
        """Raise ValueError if an input, (…, n_inputs), is not finite."""
        if not math.isfinite(np.add.reduce(u, axis=None)) and not np.isfinite(u).all():
            bad = np.asarray(~np.isfinite(u).reshape(-1, self.n_inputs).all(axis=0))
            names = ", ".join(n for n, b in zip(self.card.input_names, bad, strict=True) if b)
            raise ValueError(f"inputs of the model must be finite: {names}")

    def _advance(self) -> None:
        current = self._bindings[self._turn]
        self._run(current.binding)
        self._turn = 1 - self._turn
        self._state = current.next_state

    def force_output(self, y: FloatArray | float) -> None:
        """Overwrite the newest past output in the state with the measured one (washout).

        y : scalar or (batch,), in the output's unit; NaN keeps the prediction
        """
        value = to_model_units(self.card.transform, y)
        newest = self._state[:, self.card.state.output_start]
        limited = np.clip(value, *self.card.output_limits)
        newest[:] = np.where(np.isnan(value), newest, limited)

    def reset(self, u: Inputs, y: FloatArray | float | None = None) -> None:
        """Fill the state as if ``u`` and ``y`` had been constant over all lags.

        u : (n_inputs,) or (batch, n_inputs)
        y : scalar or (batch,), in the output's unit; by default the model predicts it from zero
        """
        self._state[:] = 0.0
        for _ in range(self.card.lags):
            self.step_batch(u)
            if y is not None:
                self.force_output(y)

    def run_batch(self, u: Inputs) -> FloatArray:
        """Return the predictions of whole recordings, shape (batch, n), step by step.

        u : shape (batch, n, n_inputs)
        Every row equals bit for bit the result of ``step`` on that row alone.
        Raises ValueError if an input is not finite.
        """
        batch, n, _ = u.shape
        if batch != self.batch:
            raise ValueError(f"u has {batch} rows, the model was made for {self.batch}")
        u = np.asarray(u, dtype=np.float32)
        self._check_finite(u)
        result = np.empty((n, batch))
        for k in range(n):
            self._u[:] = u[:, k]
            self._advance()
            result[k] = self._predicted[:, 0]
        return result.T


def open_session(content: bytes, path: str) -> ort.InferenceSession:
    """Return a single-threaded session of a file's content; raises ModelError."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # errors are raised, not printed
    try:
        return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors have no other common base
        reason = str(error).splitlines()[0]
        raise ModelError(f"{path}: not a usable ONNX file: {reason}") from None


def _prediction(session: ort.InferenceSession, card: ModelCard) -> str:
    """Return the name of the graph's prediction: after the output, or as it was once for all."""
    names = {a.name for a in session.get_outputs()}
    return USUAL_PREDICTION if USUAL_PREDICTION in names else prediction_name(card.output.name)


def check_graph(session: ort.InferenceSession, card: ModelCard, path: str) -> None:
    """Raise ModelError if the graph's inputs and outputs differ from those of the card."""
    n_state = card.state.size
    predicted = _prediction(session, card)
    wanted = {"u": len(card.inputs), "state": n_state, predicted: 1, "next_state": n_state}
    graph = {a.name: a for a in (*session.get_inputs(), *session.get_outputs())}
    if graph.keys() != wanted.keys():
        raise ModelError(f"{path}: graph has {sorted(graph)}, wanted {sorted(wanted)}")
    for name, width in wanted.items():
        array = graph[name]
        if array.type != "tensor(float)":
            raise ModelError(f"{path}: {name} is {array.type}, wanted tensor(float)")
        if len(array.shape) != 2 or array.shape[1] != width:
            raise ModelError(
                f"{path}: {name} has shape {array.shape}, its card says (batch, {width})"
            )
        if isinstance(array.shape[0], int):
            raise ModelError(f"{path}: {name} has a fixed batch of {array.shape[0]}, wanted any")
