"""Appends a line to a file for every change of a code: --sink codes:FILE."""

from datetime import UTC, datetime
from pathlib import Path


class Codes:
    """A sink; ``write`` may wait, because a run gives it a thread of its own."""

    def __init__(self, url, tags):
        self._path, self._tags = Path(url.path), " ".join(tags.values())
        self._file = None

    def write(self, records):
        """Write records; after an error they are given again."""
        if self._file is None:
            self._file = self._path.open("a", encoding="utf-8")
        for record in records:
            if record.kind == "code":
                when = datetime.fromtimestamp(record.t_ns / 1e9, UTC)
                code, state = record.values["code"], record.values["state"]
                self._file.write(f"{when:%Y-%m-%d %H:%M:%S} {self._tags} {code} {state}\n")
        self._file.flush()

    def close(self):
        """Close the file; ``write`` may open it again."""
        if self._file is not None:
            self._file.close()
            self._file = None
