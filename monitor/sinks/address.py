"""From an address on the command line to a sink: the scheme chooses the kind.

A plug-in brings a kind by the entry point ``o2_monitor.sinks``: its name is the scheme, its object
a function (or a class) from the split address and the tags to a ``Sink``. The kinds that come with
the monitor are named in the same way.
"""

from importlib.metadata import EntryPoint, entry_points
from typing import Final, cast
from urllib.parse import SplitResult, urlsplit

from monitor.base.errors import O2Error, UsageError
from monitor.base.foreign import ForeignError, foreign
from monitor.sinks.record import Sink, Tags

GROUP: Final = "o2_monitor.sinks"
_OWN: Final = {"mqtt": "mqtt:Mqtt", "mqtts": "mqtt:Mqtt", "jsonl": "json_lines:JsonLines"}


def kinds() -> dict[str, EntryPoint]:
    """Return the kinds of sinks by scheme: those of plug-ins, and the monitor's own."""
    own = (EntryPoint(name, f"monitor.sinks.{value}", GROUP) for name, value in _OWN.items())
    return {point.name: point for point in (*entry_points(group=GROUP), *own)}


def open_sink(address: str, tags: Tags) -> Sink:
    """Return the sink of an address; it connects when it first writes.

    Raises UsageError if there is no such kind, or if it cannot be had.
    """
    url, known = _split(address), kinds()
    if url.scheme not in known:
        raise UsageError(
            f"--sink {shown(address)}: no such kind; there are {', '.join(sorted(known))}"
        )
    point = known[url.scheme]
    try:
        with foreign(point.value):
            sink = point.load()(url, dict(tags))
    except ForeignError as error:
        own = error.__cause__ if isinstance(error.__cause__, O2Error) else error
        raise UsageError(f"--sink {shown(address)}: {own}") from error
    if not all(callable(getattr(sink, each, None)) for each in ("write", "close")):
        kind = type(sink).__name__
        raise UsageError(
            f"--sink {shown(address)}: {point.value} returned {kind}, a sink is wanted"
        )
    return cast(Sink, sink)


def shown(address: str) -> str:
    """Return the address as messages and pages show it: without user, password and query.

    >>> shown("mqtt://me:secret@broker:1883/car")
    'mqtt://broker:1883/car'
    """
    url = _split(address)
    where, path = url.netloc.rpartition("@")[2], url.path.partition("#")[0]
    return f"{url.scheme}://{where}{path}" if where else f"{url.scheme}:{url.path}"


def _split(address: str) -> SplitResult:
    try:
        url = urlsplit(address, allow_fragments=False)
        _ = url.port
    except ValueError as error:
        raise UsageError(f"--sink: {error}") from None
    return url
