"""The loop that a user would write with python-can, cantools and onnxruntime.

It decodes only the needed messages, holds the last values for ever, runs the model every period,
and takes mean and standard deviation of 50 residuals. It checks and judges nothing.
"""

from pathlib import Path

import can
import numpy as np

from monitor.decode.bus_map import load_database
from monitor.model.step import open_session
from monitor.pipeline.replay import Setup

N_WINDOW = 50


class PlainLoop:
    """Takes messages one by one; ``windows`` holds mean and deviation of the residuals.

    foreign : DBC text of further messages; then every message of the bus is decoded
    """

    def __init__(self, setup: Setup, foreign: str = "") -> None:
        card, channels = setup.model.card, setup.bus_map.channels
        names = (*card.input_names, card.output.name)
        self.needed = {channels[name].message.frame_id for name in names}
        self.windows: list[tuple[float, float]] = []
        self._database = load_database(setup.bus_map.pairs[0][0])
        if foreign:
            self._database.add_dbc_string(foreign)
        own = {message.frame_id for message in self._database.messages}
        self._decoded = own if foreign else self.needed
        *self._inputs, self._output = (channels[name].mapped.signal for name in names)
        self._run = open_session(setup.model.path.read_bytes(), "model").run
        self._state = np.zeros((1, card.state.size), np.float32)
        self._period_s, self._next_s = card.period_ns / 1e9, 0.0
        self._values: dict[str, float] = {}
        self._residuals: list[float] = []

    def push(self, message: can.Message) -> list[float]:
        """Take a message; return the times of the ticks that it closed, s."""
        done: list[float] = []
        values = self._values
        while message.timestamp >= self._next_s:
            tick_s = self._next_s
            self._next_s = (tick_s or message.timestamp) + self._period_s
            if len(values) < len({*self._inputs, self._output}):
                continue
            u = np.array([[values[name] for name in self._inputs]], np.float32)
            fed = {"u": u, "state": self._state}
            lambda_hat, self._state = self._run(["lambda_hat", "next_state"], fed)
            self._residuals.append(values[self._output] - float(lambda_hat[0, 0]))
            if len(self._residuals) == N_WINDOW:
                deviation = float(np.std(self._residuals))
                self.windows.append((float(np.mean(self._residuals)), deviation))
                self._residuals.clear()
            done.append(tick_s)
        if message.arbitration_id in self._decoded:
            decoded = self._database.decode_message(message.arbitration_id, message.data)
            values.update(decoded)
        return done

    def read(self, path: Path) -> None:
        """Judge a log."""
        with can.LogReader(path) as reader:
            for message in reader:
                self.push(message)
        if not self.windows:
            raise AssertionError("no window was filled")
