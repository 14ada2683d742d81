"""Where the commands ``o2mon`` and ``o2train`` begin.

The packages ``monitor``, ``training`` and ``dbc`` have names that another distribution may have,
too. This module has a name of its own, so it can say which package is in the way.
"""

import sys
from importlib.util import find_spec


def o2mon() -> int:
    """Run ``o2mon``; return the exit code."""
    if said := _hindrance():
        print(f"o2mon: {said}", file=sys.stderr)
        return 2
    from monitor.cli import main

    return main()


def o2train() -> int:
    """Run ``o2train``; return the exit code."""
    if said := _hindrance():
        print(f"o2train: {said}", file=sys.stderr)
        return 2
    from training.cli import main

    return main()


def _hindrance() -> str:
    """Return what is wrong with the packages, "" if they are this distribution's."""
    try:
        from monitor.base import own_packages
    except Exception:  # another monitor may fail in any way
        spec = find_spec("monitor")
        return (
            "another package named monitor is in the way of o2-monitor's: "
            f"{spec.origin if spec else 'none is found'}; install o2-monitor into an environment "
            "of its own (python -m venv)"
        )
    from monitor.base.errors import UsageError

    try:
        own_packages.check()
    except UsageError as error:
        return str(error)
    return ""
