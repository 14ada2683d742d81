"""Raw values of signals, read from many payloads at once."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from cantools.database.can import Message, Signal
from numpy.typing import NDArray

from monitor.base.types import IntArray
from monitor.decode.raw_values import bit_position

Bytes = NDArray[np.uint8]
Bits = NDArray[np.uint64]
Numbers = NDArray[np.int16]  # (n,) of messages or signals
Raw = NDArray[Any]  # (n,) int64 or float64; Python's integers beyond 63 bits
_WORD: Final = 64  # bits read at once


class Fields:
    """The places of signals in the payloads of their messages, (n, n_bytes)."""

    def __init__(self, signals: Iterable[tuple[Message, Signal]]) -> None:
        self._odd: list[tuple[int, Message, Signal, bool]] = []  # by number, whether it is long
        self._width = _WORD // 8  # of payloads, at least
        rows = []  # first byte of a word, whether it is big-endian; shift, mask and sign in it
        for i, (message, signal) in enumerate(signals):
            position, is_big = bit_position(message, signal), signal.byte_order == "big_endian"
            spare, length = max(message.length - _WORD // 8, 0), int(signal.length)
            self._width = max(self._width, message.length)
            position += is_big * 8 * (spare + _WORD // 8 - message.length)
            low = min(position // 8, spare)
            shift = position - 8 * low
            is_long = max(shift, not signal.is_float) + length > _WORD
            if is_odd := is_long or signal.is_float:
                self._odd.append((i, message, signal, is_long))
            sign = 0 if is_odd or not signal.is_signed else 1 << (length - 1)
            mask = (1 << min(length, _WORD - shift)) - 1
            rows.append((spare - low if is_big else low, is_big, shift, mask, sign))
        columns = np.array(rows, dtype=np.uint64).reshape(-1, 5, 1).transpose(1, 0, 2)
        self._first, self._is_big = columns[0].ravel().astype(np.int64), columns[1] > 0
        self._shift, self.mask, self._sign = columns[2:]  # each (n_signals, 1)
        self._has_big, self._has_sign = columns[1].any(), columns[4].any()

    def read(self, data: Bytes) -> tuple[IntArray, dict[int, Raw]]:
        """Return raw values, (n_signals, n), and by number those that no integer of 64 bits is."""
        bits = self._bits(data, self._first, self._is_big, self._shift, self.mask)
        raw = ((bits ^ self._sign) - self._sign if self._has_sign else bits).view(np.int64)
        return raw, {i: _odd(m, s, is_long, raw[i], data) for i, m, s, is_long in self._odd}

    def bits(self, data: Bytes, which: Numbers | list[int]) -> Bits:
        """Return the lowest bits, at most 64, of signal ``which`` in each payload, (n,)."""
        places = (each.take(which) for each in (self._is_big, self._shift, self.mask))
        return self._bits(data, (self._first.take(which), np.arange(len(data))), *places)

    def _bits(self, data: Bytes, words: Any, is_big: Any, shift: Bits, mask: Bits) -> Bits:
        """Return bits in words, given by their first bytes, or these and their payloads."""
        if (missing := self._width - data.shape[1]) > 0:
            data = np.pad(data, ((0, 0), (0, missing)))
        data, (n, width) = np.ascontiguousarray(data), data.shape
        shape = width - _WORD // 8 + 1, n  # from every byte on
        found: Bits = np.ndarray(shape, "<u8", data, strides=(1, width))[words]
        if self._has_big:
            found = np.where(is_big, found.byteswap(), found)
        return found >> shift & mask


def _odd(message: Message, signal: Signal, is_long: bool, raw: Raw, data: Bytes) -> Raw:
    """Return floating-point numbers, or integers that are too long for ``raw``."""
    if is_long:
        order = "little" if signal.byte_order == "little_endian" else "big"
        sign = 1 << (signal.length - 1) if signal.is_signed and not signal.is_float else 0
        position, mask = bit_position(message, signal), (1 << signal.length) - 1
        rows = (row.tobytes().ljust(message.length, b"\0")[: message.length] for row in data)
        whole = (int.from_bytes(row, order) for row in rows)  # type: ignore[arg-type]
        raw = np.empty(len(data), dtype=object)
        raw[:] = [(((each >> position) & mask) ^ sign) - sign for each in whole]
    if signal.is_float:
        size = signal.length // 8
        return raw.astype(f"<u{size}").view(f"<f{size}").astype(np.float64)
    return raw
