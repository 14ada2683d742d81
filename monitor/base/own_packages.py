"""Whether ``monitor``, ``training`` and ``dbc`` are the packages of this project.

The names are short, and another distribution may have a package of the same name: in a folder that
comes first on Python's path, or in the same folder, where the later installation wins. A plain
folder of the name wins over a project that is installed editable.
"""

from collections.abc import Iterable
from functools import cache
from importlib.metadata import packages_distributions
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from monitor.base.errors import UsageError

NAMES: Final = ("monitor", "training", "dbc")
MARK: Final = '__distribution__ = "o2-monitor"'  # a line of each package's __init__.py


@cache
def check(names: Iterable[str] = NAMES) -> None:
    """Raise UsageError if a package of one of these names is another distribution's."""
    for name in names:
        spec = find_spec(name)
        if spec is None:
            raise UsageError(
                f"the package {name} of o2-monitor is missing: install o2-monitor anew"
            )
        if spec.origin is None:  # a folder of this name, such as one of databases
            raise UsageError(in_the_way(name, ", ".join(spec.submodule_search_locations or ())))
        place = spec.origin
        if MARK not in Path(place).read_text("utf-8", "replace"):
            raise UsageError(in_the_way(name, place))


def in_the_way(name: str, place: str) -> str:
    """Return the mistake, the likely owner of the package, and the remedy."""
    others = set(packages_distributions().get(name, [])) - {"o2-monitor"}
    whose = f" of {' or '.join(sorted(others))}" if others else ""
    return (
        f"another package named {name}{whose} is in the way of o2-monitor's: {place}; install "
        "o2-monitor into an environment of its own (python -m venv)"
    )
