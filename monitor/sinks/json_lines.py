"""Lines of JSON, appended to a file or printed, for Telegraf, Vector, Loki and the like."""

import os
from collections.abc import Sequence
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Final
from urllib.parse import SplitResult

from monitor.base.errors import UsageError
from monitor.sinks.record import Record, Tags, json_of

STDOUT = "-"
_HEAD: Final = b'{"kind": "'  # of each line


class JsonLines:
    """Writes one line per record.

    Raises UsageError if the address names no file, or one that holds something else than records.
    """

    def __init__(self, url: SplitResult, tags: Tags) -> None:
        if not url.path or url.netloc:
            raise UsageError(f"a path is wanted, as {url.scheme}:FILE, or - for the output")
        self._path, self._tags = url._replace(scheme="").geturl(), tags
        self._file: FileIO | None = None
        if not _HEAD.startswith(_ends(Path(self._path))[0]):
            raise UsageError("is there already and holds no records; choose another file")

    def write(self, records: Sequence[Record]) -> None:
        """Append the records, all of them or none.

        Raises OSError if the file cannot be written.
        """
        lines = "".join(json_of(record, self._tags) + "\n" for record in records).encode()
        if self._file is None:
            is_torn = _ends(Path(self._path))[1] not in (b"", b"\n")  # by a kill
            # stdout of its own: one that hangs holds up no exit
            self._file = FileIO(os.dup(1) if self._path == STDOUT else self._path, "a")
            lines = b"\n" * is_torn + lines
        number = self._file.fileno()
        n_before = os.fstat(number).st_size
        try:
            while lines:
                lines = lines[os.write(number, lines) :]
        except OSError:
            with suppress(OSError):  # a pipe takes nothing back
                os.truncate(number, n_before)
            raise

    def close(self) -> None:
        """Close the file."""
        if self._file:
            self._file.close()
        self._file = None


def _ends(path: Path) -> tuple[bytes, bytes]:
    """Return how a file begins, and its last byte; nothing of one that is none or not there."""
    if not path.is_file():
        return b"", b""
    with path.open("rb") as file:
        head = file.read(len(_HEAD))
        file.seek(max(path.stat().st_size - 1, 0))
        return head, file.read()
