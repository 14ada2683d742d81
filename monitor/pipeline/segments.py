"""Model and sensor bank on runs of samples with valid inputs, many recordings side by side."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.config import ResponseConfig
from monitor.base.types import BoolArray, FloatArray, SampleBlock
from monitor.judge.response.bank import Bank, BankState
from monitor.judge.window import Span, Windows, oriented
from monitor.model.step import Float32Array, Model
from monitor.pipeline.conclusions import Findings


class RunState(NamedTuple):
    """Model and bank behind a sample with valid inputs."""

    model: Float32Array  # (n_state,)
    bank: BankState


class Filling(NamedTuple):
    """Windows of one kind, and the samples that may fill them."""

    windows: Windows
    samples: BoolArray  # (n,)
    spans: list[Span]  # those that do, once model and bank have run


@dataclass(slots=True)
class Part:
    """Samples of one recording, in one driving cycle, on their way through the steps."""

    block: SampleBlock
    measured: FloatArray  # (n,) output's unit
    conditions: BoolArray  # (n, n_conditions)
    enabled: BoolArray  # (n,)
    segments: list[tuple[int, int]]  # runs of samples with valid inputs
    found: Findings
    kinds: tuple[Filling, ...]  # of enabled samples, and of those that only a fuel cut disables
    run: RunState | None  # that the first segment goes on from, if it begins with the block
    predicted: FloatArray  # (n,) output's unit, NaN until it is filled in
    end: RunState | None = None  # behind the last sample


class _Row(NamedTuple):
    """One segment of a part."""

    part: Part
    begin: int
    end: int
    state: RunState | None  # that the segment goes on from, None if it begins here
    is_last: bool  # the segment may go on in the recording's next block

    def spans(self, usable: BoolArray) -> Iterator[tuple[list[Span], int, int]]:
        """Yield the samples of the segment that fill windows, and the part's spans they join.

        usable : (n,) of the segment, samples with a prediction
        """
        inside, goes_on = slice(self.begin, self.end), self.state is not None
        for windows, samples, target in self.part.kinds:
            found = windows.spans(samples[inside] & usable, goes_on=goes_on, is_last=self.is_last)
            for begin, end in found:
                yield target, begin, end


class Segments:
    """Runs model and bank on the segments of parts.

    inputs : places of the model's inputs in a sample
    rows : most segments side by side
    """

    def __init__(
        self,
        model: Model,
        config: ResponseConfig,
        inputs: Sequence[int],
        period_s: float,
        rows: int,
    ) -> None:
        self._models = {1: model.with_batch(1)}
        self._card, self._inputs, self._n_rows = model.card, np.array(inputs), rows
        self._bank = Bank(config, period_s)

    def run(self, parts: Sequence[Part]) -> None:
        """Fill in the predictions of parts, and the bank's readings where windows need them."""
        rows = [
            _Row(part, begin, end, None if begin else part.run, end == len(part.measured))
            for part in parts
            for begin, end in part.segments
        ]
        rows.sort(key=lambda row: row.begin - row.end)
        for first in range(0, len(rows), self._n_rows):
            self._run(rows[first : first + self._n_rows])
        for part in parts:
            for kind in part.kinds:
                kind.spans.sort(key=lambda span: span.begin)

    def _run(self, rows: Sequence[_Row]) -> None:
        """Run the rows, the longest first."""
        lengths = [row.end - row.begin for row in rows]
        predicted, states = self._predict(rows, lengths)
        begins: list[BankState] = []
        spans, targets = list[tuple[int, int, int]](), list[list[Span]]()
        values = oriented(predicted, self._card.transform)
        for i, (row, value) in enumerate(zip(rows, values[:, 0].tolist(), strict=True)):
            part, inside = row.part, slice(row.begin, row.end)
            own = part.predicted[inside] = predicted[i, : lengths[i]]
            begins.append(row.state.bank if row.state else self._bank.begin(value))
            usable = own == own  # noqa: PLR0124
            for target, begin, end in row.spans(usable):
                spans.append((i, begin, end))
                targets.append(target)
        read, ends = self._bank.push(values, lengths, begins, spans)
        for target, own, (i, begin, end) in zip(targets, read, spans, strict=True):
            target.append(Span(rows[i].begin + begin, rows[i].begin + end, own))
        for i, row in enumerate(rows):
            if row.is_last:
                row.part.end = RunState(states[i], ends[i])

    def _predict(
        self, rows: Sequence[_Row], lengths: Sequence[int]
    ) -> tuple[FloatArray, dict[int, Float32Array]]:
        """Return predictions, (rows, n), anything behind a row's end, and the last states."""
        u = self._u(rows, lengths)
        model = self._model(len(rows))
        goes_on = [row.state for row in rows]
        if not all(goes_on):
            model.reset(u[:, 0], np.array([row.part.measured.item(row.begin) for row in rows]))
        for i, state in enumerate(goes_on):
            if state is not None:
                model.state[i] = state.model
        predicted, states = np.empty(u.shape[:2]), dict[int, Float32Array]()
        ends = {n for n, row in zip(lengths, rows, strict=True) if row.is_last}
        for begin, end in pairwise([0, *sorted({*ends, lengths[0]})]):
            predicted[:, begin:end] = model.run_batch(u[:, begin:end])
            states |= {i: model.state[i].copy() for i, n in enumerate(lengths) if n == end}
        return predicted, states

    def _u(self, rows: Sequence[_Row], lengths: Sequence[int]) -> NDArray[np.float32]:
        """Return the model's inputs, (rows, n, n_inputs), its last ones behind a row's end."""
        # the inputs of all rows in one step lie together in memory
        steps = np.empty((lengths[0], len(rows), len(self._inputs)), np.float32)
        for i, (part, begin, end, *_) in enumerate(rows):
            own = part.block.values[begin:end].take(self._inputs, axis=1)
            steps[: len(own), i], steps[len(own) :, i] = own, own[-1]
        return steps.transpose(1, 0, 2)

    def _model(self, batch: int) -> Model:
        if batch not in self._models:
            self._models[batch] = self._models[1].with_batch(batch)
        return self._models[batch]
