"""Appends every record to a file, as one line of JSON: --sink jsonl:FILE."""

import json
from pathlib import Path


class JsonLines:
    """A sink; ``write`` may wait, because a run gives it a thread of its own."""

    def __init__(self, url, tags):
        self._path, self._tags = Path(url.path), tags
        self._file = None

    def write(self, records):
        """Write records; after an error they are given again."""
        if self._file is None:
            self._file = self._path.open("a", encoding="utf-8")
        for record in records:
            line = {"kind": record.kind, "t_ns": record.t_ns, **self._tags, **record.values}
            self._file.write(json.dumps(line) + "\n")
        self._file.flush()

    def close(self):
        """Close the file; ``write`` may open it again."""
        if self._file is not None:
            self._file.close()
            self._file = None
