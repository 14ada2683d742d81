"""Values of the open tick: the decoders add to them, the assembler takes them."""

from typing import Final

from monitor.base.types import Quality, Update

_GOOD: Final = int(Quality.GOOD)
_BAD_VALUES: Final = {int(Quality.INVALID): float("nan"), int(Quality.OUT_OF_RANGE): float("inf")}


class Received:
    """Plain lists with a place per channel, because generated code adds to them at every frame.

    They stay the same lists for ever: that code has them bound.
    """

    __slots__ = ("goods", "sums", "times_ns", "worst")

    def __init__(self, n_channels: int) -> None:
        self.sums = [0.0] * n_channels  # of the good values
        self.goods = [0] * n_channels  # number of the good values
        self.worst = [_GOOD] * n_channels  # Quality of the worst bad value
        self.times_ns = [0] * n_channels  # of the last value; outlives the tick

    def clear(self) -> None:
        """Forget all values."""
        n = len(self.sums)
        self.sums[:] = [0.0] * n
        self.goods[:] = [0] * n
        self.worst[:] = [_GOOD] * n

    def copy(self) -> "Received":
        """Return the values so far, to ``restore`` them."""
        copy = Received(0)
        copy.restore(self)
        return copy

    def restore(self, other: "Received") -> None:
        """Take the values of another in place of these."""
        self.sums[:] = other.sums
        self.goods[:] = other.goods
        self.worst[:] = other.worst
        self.times_ns[:] = other.times_ns

    def update(self) -> Update:
        """Return the channels with values and their sums, or a bad value where none is good."""
        found = [
            (channel, self.sums[channel] if good else _BAD_VALUES[self.worst[channel]])
            for channel, good in enumerate(self.goods)
            if good or self.worst[channel]
        ]
        channels, values = zip(*found, strict=True) if found else ((), ())
        return channels, values
