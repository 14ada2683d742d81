"""The channels of a log: an identifier means one thing on one bus, and another on the next."""

from collections.abc import Collection, Iterator, Sequence
from itertools import islice

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import Frame, FrameBlock, IntArray
from monitor.frames.blocks import FRAMES, block_of, chosen


class Channels:
    """Keeps the frames of one channel, and refuses a log in which two buses are mixed.

    only : name of the channel to keep, as the log has it; "" keeps all
    mapped : keys of the frames that the signal map reads (``FrameBlock.key``)
    """

    def __init__(self, only: str = "", mapped: Collection[int] = ()) -> None:
        self.only, self._mapped = only, np.array(sorted(mapped), dtype=np.uint32)
        self._heard: dict[str, set[int]] = {}  # mapped keys by channel
        self._first: dict[int, str] = {}  # channel of each of them

    @property
    def matter(self) -> bool:
        """Return whether a frame's channel makes a difference."""
        return bool(self.only or len(self._mapped))

    def keep(
        self, block: FrameBlock, names: Sequence[str], places: IntArray | None = None
    ) -> FrameBlock:
        """Return the frames of the wanted channel.

        names : channels; places : (n,) index of each frame's name, None if all have the first
        Raises RecordingError, without the file's name, if a mapped identifier is on two channels.
        """
        for place, name in enumerate(names):
            heard = self._heard.setdefault(name, set())
            if self.only or len(heard) == len(self._mapped):
                continue
            keys = block.key if places is None else block.key[places == place]
            for key in np.unique(keys[np.isin(keys, self._mapped)]).tolist():
                heard.add(key)
                if (other := self._first.setdefault(key, name)) != name:
                    raise RecordingError(
                        f"the mapped identifier {key & 0x1FFFFFFF:03X} is on the channels "
                        f"{other!r} and {name!r}: choose one with --channel NAME"
                    )
        if self.only:
            if places is None:
                return block if self.only == names[0] else chosen(block, slice(0))
            wanted = [place for place, name in enumerate(names) if name == self.only]
            return chosen(block, np.isin(places, wanted))
        return block

    def keep_numbered(self, block: FrameBlock, numbers: IntArray) -> FrameBlock:
        """Return the frames of the wanted channel; ``numbers``, (n,), are the channels' names."""
        if len(numbers) == 0 or (numbers == numbers[0]).all():
            return self.keep(block, [str(number) for number in numbers[:1]])
        unique, places = np.unique(numbers, return_inverse=True)
        return self.keep(block, [str(number) for number in unique], places)

    def blocks_of(self, frames: Iterator[tuple[Frame, str]]) -> Iterator[FrameBlock]:
        """Yield the frames of the wanted channel as blocks; those before an error come before it.

        frames : each with its channel's name
        """
        error: Exception | None = None
        while error is None:
            chunk: list[tuple[Frame, str]] = []
            try:
                chunk.extend(islice(frames, FRAMES))
            except Exception as raised:  # readers have no common base for their errors
                error = raised
            if not chunk and error is None:
                return
            names = {name: place for place, name in enumerate(dict.fromkeys(n for _, n in chunk))}
            places = np.array([names[name] for _, name in chunk]) if len(names) > 1 else None
            block = block_of([frame for frame, _ in chunk])
            yield self.keep(block, tuple(names), places)
        raise error

    def finish(self) -> None:
        """Raise RecordingError if the wanted channel is none of the log."""
        if self.only and self._heard and self.only not in self._heard:
            raise RecordingError(
                f"no channel {self.only}, there are {', '.join(map(repr, sorted(self._heard)))}"
            )
