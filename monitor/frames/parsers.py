"""A compiled parser of candump text, where the installation brings one.

A distribution announces it as an entry point of the group ``o2_monitor.candump_parsers``. This one
announces its own, which needs numba of the extra [fleet]. Its frames, counters and errors are those
of numpy's parser in ``monitor.frames.candump_blocks``, which serves where there is none.
"""

import logging
from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final

from monitor.frames.candump_blocks import Parser

_LOG: Final = logging.getLogger("o2_monitor")
GROUP: Final = "o2_monitor.candump_parsers"
# Loading and unloading numba and its code takes 0.7 s of processor time. The compiled parser takes
# 1.0 ms per MB, numpy's 3.2 ms: with less than 330 MB of text, numpy's is done sooner.
LEAST_BYTES = 330_000_000
_SUFFIXES: Final = (".log", ".log.gz")


def parser_for(paths: Iterable[Path]) -> Parser | None:
    """Return the compiled parser if it is done with the logs sooner than numpy's, else None.

    paths : logs to read; files that are no candump text, or cannot be read, do not count
    """
    logs = (path for path in paths if path.name.lower().endswith(_SUFFIXES) and path.is_file())
    n_bytes = sum(path.stat().st_size for path in logs)  # gzipped text counts with its file's size
    return compiled_parser() if n_bytes >= LEAST_BYTES else None


def compiled_parser() -> Parser | None:
    """Return the compiled parser, None if none is announced or its libraries are missing."""
    for point in entry_points(group=GROUP):
        try:
            parser: Parser = point.load()
        except Exception as error:  # whatever ails it, numpy's parser reads the log
            _LOG.info("compiled parser %r is left out: %s", point.name, error)
            continue
        return parser
    return None
