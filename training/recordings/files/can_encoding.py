"""Values to payloads: CAN encoding of whole recordings at once.

The reverse of ``decode.block_decoder``, with the alive counter and the checksum of the map.
"""

from collections.abc import Mapping

import numpy as np
from cantools.database.can import Message, Signal
from numpy.typing import NDArray

from monitor.base.errors import SignalMapError
from monitor.base.types import FloatArray
from monitor.decode.checksum import payload_checksums
from monitor.decode.raw_values import bit_position
from monitor.decode.signal_map import Integrity

Payloads = NDArray[np.uint8]


def encode_message(
    message: Message,
    integrity: Integrity,
    values: Mapping[str, FloatArray],
    n: int,
    first_count: int = 0,
    count_step: int = 1,
) -> Payloads:
    """Return the payloads of ``n`` frames of one message, shape (n, message.length).

    message : from the CAN database; at most 8 bytes, its signals integer
    integrity : counter, checksum and the raw value that says not available
    values : physical values (n,) of its signals; NaN or a missing signal is sent as not available,
        or as 0 where the message has no such value; values beyond the range saturate
    first_count : alive counter of the first frame
    count_step : by which it counts up from frame to frame
    Raises SignalMapError if the message cannot be encoded or lacks a signal.
    """
    if message.length > 8:
        raise SignalMapError(f"{message.name} has {message.length} bytes, at most 8 are wanted")
    signals = {signal.name: signal for signal in message.signals}
    if unknown := sorted(values.keys() - signals.keys()):
        raise SignalMapError(f"{message.name} has no signal {unknown[0]}")
    words = {"little_endian": np.zeros(n, np.uint64), "big_endian": np.zeros(n, np.uint64)}
    for name, signal in signals.items():
        if name == integrity.checksum:
            continue
        if name == integrity.counter:
            raw = (first_count + count_step * np.arange(n, dtype=np.int64)) % (1 << signal.length)
        elif not _is_sent(signal, signals, values):
            continue
        else:
            raw = _raw(signal, integrity, values.get(name, np.full(n, np.nan)), n)
        _pack(words[signal.byte_order], message, signal, raw)
    big = words["big_endian"] << np.uint64(8 * (8 - message.length))
    both = words["little_endian"].astype("<u8").view(np.uint8) | big.astype(">u8").view(np.uint8)
    payloads: Payloads = both.reshape(n, 8)[:, : message.length].copy()
    if integrity.checksum:
        place = signals[integrity.checksum].start // 8
        payloads[:, place] = payload_checksums(
            integrity.algorithm, message.frame_id, payloads, place
        )
    return payloads


def _is_sent(
    signal: Signal, signals: Mapping[str, Signal], values: Mapping[str, FloatArray]
) -> bool:
    """Return whether a signal is sent; a multiplexed one needs a value and its multiplexer."""
    if signal.multiplexer_signal is None:
        return True
    return signal.name in values and signal.multiplexer_signal in signals


def _raw(signal: Signal, integrity: Integrity, physical: FloatArray, n: int) -> NDArray[np.int64]:
    """Return raw values as integers, (n,)."""
    if signal.is_float:
        raise SignalMapError(f"signal {signal.name} is a float, integers are wanted")
    bits, half = signal.length, 1 << (signal.length - 1)
    low, high = (-half, half - 1) if signal.is_signed else (0, 2 * half - 1)
    missing = 0
    if integrity.not_available and bits >= 2:
        missing = low if signal.is_signed else high
        low, high = (low + 1, high) if signal.is_signed else (low, high - 1)
    if physical.shape != (n,):
        raise SignalMapError(f"signal {signal.name} has shape {physical.shape}, ({n},) is wanted")
    scaled = np.rint((physical - float(signal.offset)) / float(signal.scale))
    gone = np.isnan(scaled)
    sent = np.clip(np.where(gone, 0.0, scaled), low, high).astype(np.int64)
    none = np.uint64(missing % 2**64).astype(np.int64)  # the same bits, also of 64 without a sign
    return np.where(gone, none, sent)


def _pack(
    word: NDArray[np.uint64], message: Message, signal: Signal, raw: NDArray[np.int64]
) -> None:
    """Put raw values into the payloads, seen as integers in the signal's byte order."""
    mask = np.uint64((1 << signal.length) - 1)
    word |= (raw.astype(np.uint64) & mask) << np.uint64(bit_position(message, signal))
