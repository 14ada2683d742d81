"""The redundant block of a fault memory, as the memories of production ECUs have it (AUTOSAR NvM).

FILE and FILE.b hold the same lines: pieces of the content, each with a checksum and the number of
its generation. A storing writes one file after the other, each beside its place and renamed, so a
file is never there in part. A file that missed its turn is the first the next time. So once a
storing has ended, each file alone holds its content, whatever ends the process or fills the disk.

================  ================  =======================================  ========
one file          the other         content                                  state
================  ================  =======================================  ========
whole             whole             that of the higher generation            ok
FILE whole        FILE.b missing    FILE's, for example of a copy            ok
whole             damaged, missing  that of the whole file                   repaired
damaged           damaged           of the lines of both, if none is gone    repaired
damaged           damaged, missing  none                                     lost
missing           missing           empty: a new memory                      ok
FILE not ours     FILE.b missing    refused                                  –
================  ================  =======================================  ========
"""

import hashlib
import os
import shutil
from collections import defaultdict, deque
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Final, NamedTuple

from monitor.base.errors import RecordingError
from monitor.base.files.outputs import take_place
from monitor.memory.content import Content, content_of, text_of

SUFFIX: Final = ".b"
ASIDE: Final = "-damaged-"  # between the name of a lost memory and its number
MAGIC: Final = b"o2mon "  # at the beginning of each line
PIECE: Final = 200  # characters of the content in a line
LARGEST: Final = 16_000_000  # bytes; a memory of 100 codes has 30,000


class StoredContent(NamedTuple):
    """What the two files hold together."""

    content: Content | None  # None if it is lost
    says: str = ""  # the damage, if there is one
    is_whole: bool = False  # both files hold the content


class BlockFile(NamedTuple):
    """What one of the files holds."""

    data: bytes
    note: str = "has changed"  # if it does not hold a content

    @property
    def content(self) -> Content | None:
        """Return the content, None if it is not whole; raises as ``content_of``."""
        return _joined(self.data)


MISSING: Final = BlockFile(b"", "is missing")


class Block:
    """The two files of a fault memory; behind a symbolic link they lie beside its goal."""

    def __init__(self, path: Path) -> None:
        place = path.resolve() if path.is_symlink() else path
        self.files = (place, _partner_of(place))
        self._turn = deque(self.files)

    def read(self) -> StoredContent:
        """Return what the files hold.

        Raises RecordingError if they cannot be read, have a newer schema or were never a memory.
        """
        parts = self.parts
        try:
            return self._agreed(*parts)
        except (ValueError, TypeError, KeyError) as error:
            raise RecordingError(
                f"{self.files[0]}: fault memory of another version: {error}"
            ) from None

    def _agreed(self, one: BlockFile, other: BlockFile) -> StoredContent:
        """Return the content of the files, see the table above, and whose turn it is."""
        first, second = one.content, other.content
        names = [file.name for file in self.files]
        if first and second:
            is_newer = first.memory == second.memory and first.generation < second.generation
            self._turn = deque(self.files if is_newer else reversed(self.files))
            return StoredContent(second if is_newer else first, is_whole=first == second)
        self._turn = deque(reversed(self.files) if first else self.files)
        if first:
            says = f"{names[1]} {other.note}, {names[0]} was whole"
            return StoredContent(first, "" if other == MISSING else says)
        if second:
            hint = " (to begin anew, remove both)" * (one == MISSING)
            return StoredContent(second, f"{names[0]} {one.note}, {names[1]} was whole{hint}")
        if other == MISSING:
            return self._alone(one)
        both = _joined(b"\n".join((one.data, other.data)))
        says = f"{names[0]} {one.note}, {names[1]} {other.note}"
        return StoredContent(both, f"{says}, together they were whole")

    @property
    def parts(self) -> list[BlockFile]:
        """Return what each file holds; raises RecordingError if one cannot be opened."""
        return [_part(file) for file in self.files]

    def _alone(self, first: BlockFile) -> StoredContent:
        """Return what there is if FILE is not whole and has no partner."""
        if MAGIC in first.data:
            return StoredContent(None, f"{self.files[0].name} {first.note}")
        if first.data:
            raise RecordingError(f"{self.files[0]}: not a fault memory; choose another file")
        return StoredContent(Content())

    def write(self, content: Content) -> None:
        """Write both files in turn; raises OSError, and then none, or only the first, is new."""
        data = b"".join(_lines(content))
        for file in tuple(self._turn):
            _replace(file, data)
            self._turn.rotate(-1)
        if os.name != "nt":  # Windows opens no folders
            folder = os.open(self.files[0].parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

    def put_aside(self) -> str:
        """Copy what is left of the files to new names; return the name of the first copy.

        The files stay until new ones replace them, so a kill meanwhile hides no loss.
        """
        names = (self.files[0].with_name(f"{self.files[0].name}{ASIDE}{n}") for n in count(1))
        asides = ((name, _partner_of(name)) for name in names)
        free = next(pair for pair in asides if not any(aside.exists() for aside in pair))
        for file, aside in zip(self.files, free, strict=True):
            if file.exists():
                shutil.copyfile(file, aside)
        return next(aside.name for aside in free if aside.exists())


def _partner_of(path: Path) -> Path:
    return Path(f"{path}{SUFFIX}")


def _part(file: Path) -> BlockFile:
    try:
        with file.open("rb") as opened:
            return BlockFile(opened.read(LARGEST))
    except FileNotFoundError:
        return MISSING
    except (PermissionError, IsADirectoryError) as error:
        raise RecordingError(f"{file}: cannot open the fault memory: {error.strerror}") from None
    except OSError as error:
        return BlockFile(b"", f"cannot be read ({error.strerror})")


def _lines(content: Content) -> Iterator[bytes]:
    """Yield the lines of a file: checksum, state, number of pieces, place, and the piece."""
    text = text_of(content)
    begins = range(0, len(text), PIECE)
    for i, begin in enumerate(begins):
        place = f"{content.memory} {content.generation} {len(begins)} {i}"
        line = f"{place} {text[begin : begin + PIECE]}".encode()
        yield MAGIC + _checksum(line) + b" " + line + b"\n"


def _joined(data: bytes) -> Content | None:
    """Return the latest content of which all lines are there; raises as ``content_of``."""
    pieces = defaultdict[tuple[bytes, ...], dict[int, bytes]](dict)
    for line in data.split(b"\n"):
        checksum, _, rest = line.removeprefix(MAGIC).partition(b" ")
        if checksum == _checksum(rest):
            *state, place, piece = rest.split(b" ", 4)
            pieces[tuple(state)][int(place)] = piece
    whole = {int(state[1]): each for state, each in pieces.items() if len(each) == int(state[2])}
    if not whole:
        return None
    latest = whole[max(whole)]
    return content_of(b"".join(latest[i] for i in range(len(latest))))


def _checksum(line: bytes) -> bytes:
    return hashlib.sha256(line).hexdigest()[:16].encode()


def _replace(file: Path, data: bytes) -> None:
    """Replace a file in one step, once the data are on the disk; raises OSError."""
    begun = file.with_name(file.name + "-begun")
    begun.write_bytes(data)
    take_place(begun, file)
