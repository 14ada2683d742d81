"""Payloads of one message side by side, and the raw values in them."""

from typing import Any

import numpy as np
from cantools.database.can import Message, Signal
from numpy.typing import NDArray

from monitor.base.types import IntArray
from monitor.decode.raw_values import bit_position

Bytes = NDArray[np.uint8]
Raw = NDArray[Any]  # (n,) uint64, int64 or float64; Python's integers beyond 64 bits
_WORD = 64  # bits worked on at once


class Payloads:
    """Payloads of one message side by side, ``data`` (n, n_bytes)."""

    def __init__(self, message: Message, data: Bytes) -> None:
        self._message, self._data = message, data
        self._words: dict[tuple[str, int], NDArray[np.uint64]] = {}

    def __len__(self) -> int:
        return len(self._data)

    def at(self, places: IntArray) -> "Payloads":
        """Return those at the places."""
        return Payloads(self._message, self._data[places])

    def raw(self, signal: Signal) -> Raw:
        """Return a signal's raw values, (n,)."""
        position, length = bit_position(self._message, signal), signal.length
        if length > _WORD:
            return self._beyond(signal, position)
        first = position // 8 if self._data.shape[1] > _WORD // 8 else 0
        shift = position - 8 * first
        value = self._word(signal.byte_order, first) >> np.uint64(shift)
        if shift + length > _WORD:
            value |= self._word(signal.byte_order, first + 8) << np.uint64(_WORD - shift)
        if length < _WORD:
            value &= np.uint64((1 << length) - 1)
        if signal.is_float:
            number = value.astype(f"<u{length // 8}").view(f"<f{length // 8}")
            with np.errstate(invalid="ignore"):  # signalling NaN
                return number.astype(np.float64)
        if signal.is_signed:
            sign = np.int64(1 << (length - 1)) if length < _WORD else np.int64(0)
            return (value.view(np.int64) ^ sign) - sign
        return value

    def _word(self, byte_order: str, first: int) -> NDArray[np.uint64]:
        """Return eight bytes as integers, (n,), counted from the lowest one."""
        known = self._words.get((byte_order, first))
        if known is not None:
            return known
        ordered = self._data if byte_order == "little_endian" else self._data[:, ::-1]
        part = ordered[:, first : first + 8]
        eight = np.zeros((len(part), 8), dtype=np.uint8)
        eight[:, : part.shape[1]] = part
        word = eight.view("<u8")[:, 0]
        self._words[byte_order, first] = word
        return word

    def _beyond(self, signal: Signal, position: int) -> Raw:
        """Return raw values of more than 64 bits as Python's integers."""
        order = "little" if signal.byte_order == "little_endian" else "big"
        sign = 1 << (signal.length - 1) if signal.is_signed else 0
        mask = (1 << signal.length) - 1
        whole = (int.from_bytes(row.tobytes(), order) for row in self._data)  # type: ignore[arg-type]
        found = np.empty(len(self._data), dtype=object)
        found[:] = [(((each >> position) & mask) ^ sign) - sign for each in whole]
        return found
