"""Lines of JSON, appended to a file or printed, for Telegraf, Vector, Loki and the like."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final, TextIO
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
        self._file: TextIO | None = None
        if not _HEAD.startswith(_ends(Path(self._path))[0]):
            raise UsageError("is there already and holds no records; choose another file")

    def write(self, records: Sequence[Record]) -> None:
        """Append the records.

        Raises OSError if the file cannot be written.
        """
        if self._file is None and self._path == STDOUT:  # its own: one that hangs holds up no exit
            self._file = os.fdopen(os.dup(1), "w", encoding="utf-8")
        elif self._file is None:
            is_torn = _ends(Path(self._path))[1] not in (b"", b"\n")  # by a kill
            self._file = Path(self._path).open("a", encoding="utf-8")  # noqa: SIM115 - in ``close``
            self._file.write("\n" * is_torn)
        self._file.writelines(json_of(record, self._tags) + "\n" for record in records)
        self._file.flush()

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
