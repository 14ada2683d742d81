"""The page of each drive with a code, made by ``o2mon replay`` for the fleet's page to link."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from training.cli.fleet import FleetCommand

LIMIT_S: Final = 300.0  # for one drive


def write(args: "FleetCommand", drives: Sequence[str]) -> dict[str, str]:
    """Replay up to ``--reports`` drives and return the page of each, relative to ``--out``.

    Every drive is judged alone, without its vehicle's memory. A drive that this machine cannot read
    has no page.
    """
    folder = args.out.with_name(f"{args.out.stem}.drives")
    pages = {}
    for number, drive in enumerate(drives[: args.reports], 1):
        if not Path(drive).is_file():
            continue
        folder.mkdir(exist_ok=True)
        page = folder / f"{number:02}_{Path(drive).name}.html"
        if _replayed(args, drive, page):
            pages[drive] = f"{folder.name}/{page.name}"
    return pages


def _replayed(args: "FleetCommand", drive: str, page: Path) -> bool:
    """Write the page of one drive; return whether there is one."""
    call = [sys.executable, "-m", "monitor.cli", "replay", drive, "--model", str(args.model)]
    for database, signal_map in zip(args.dbc, args.map, strict=True):
        call += ["--dbc", str(database), "--map", str(signal_map)]
    more = {"--profile": args.columns, "--config": args.config, "--channel": args.channel}
    call += [text for name, value in more.items() if value for text in (name, str(value))]
    page.unlink(missing_ok=True)
    try:
        subprocess.run(
            [*call, "--quiet", "--html", str(page)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    return page.exists()
