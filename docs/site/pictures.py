"""Take the pictures of the pages anew: docs/pictures/report.png, live.png and gap.png.

    python docs/site/pictures.py [report|live|gap …]      gap takes some minutes

All drives are simulated. The pages are opened in Debian's chromium.
"""

import base64
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from playwright.sync_api import Browser

from tests.helpers.bus.chromium import chromium
from tests.helpers.bus.live_player import Player
from tests.helpers.logs.replays import frames_of

ROOT: Final = Path(__file__).resolve().parents[2]
PICTURES: Final = ROOT / "docs" / "pictures"
FAULT: Final = "delay_rich_to_lean"


def main() -> None:
    """Take the pictures that the arguments name, by default all."""
    chosen = sys.argv[1:] or [each.__name__ for each in (report, live, gap)]
    with chromium() as browser, tempfile.TemporaryDirectory() as folder:
        for name in chosen:
            {"report": report, "live": live, "gap": gap}[name](browser, Path(folder))
            print(PICTURES / f"{name}.png")


def report(browser: Browser, folder: Path) -> None:
    """Show the verdict on a late sensor: the page's recording, from its name on."""
    (log,) = ROOT.glob(f"replay_logs/{FAULT}_*.blf")
    log = log.relative_to(ROOT)  # the page shows the path
    _run("monitor.cli", "replay", log, "--quiet", "--html", folder / "report.html", may_end_with=1)
    page = browser.new_page(viewport={"width": 1240, "height": 1400})
    page.goto((folder / "report.html").as_uri())
    page.evaluate("document.querySelector('.recording').scrollIntoView()")
    page.wait_for_timeout(500)
    page.screenshot(path=PICTURES / "report.png")


def live(browser: Browser, folder: Path) -> None:
    """Show the live page on a laptop, light, beside a phone, dark."""
    shots = []
    with Player() as player:
        shown = {
            scheme: browser.new_page(
                viewport={"width": width, "height": 1000},
                color_scheme=scheme,
            )
            for scheme, width in (("light", 1320), ("dark", 460))
        }
        for page in shown.values():
            page.goto(player.url)
        player.push(frames_of(FAULT, 345.0))
        player.work(2.0)
        for scheme, page in shown.items():
            page.screenshot(path=folder / f"{scheme}.png")
            shots.append(base64.b64encode((folder / f"{scheme}.png").read_bytes()).decode())
    both = browser.new_page(viewport={"width": 1796, "height": 1000})
    images = "".join(f'<img src="data:image/png;base64,{shot}">' for shot in shots)
    both.set_content(f'<body style="margin:0;display:flex;gap:16px">{images}</body>')
    both.screenshot(path=PICTURES / "live.png")


def gap(browser: Browser, folder: Path) -> None:
    """Show a gap that is found, named and closed: a chain, then a vehicle that wets its walls."""
    simulate = ["simulate", "--format", "parquet", "--vehicle", "31", "--cycle", "micro_trips"]
    for seed in (1, 2, 3, 4):
        _run("training.cli", *simulate, "--seed", seed, "--out", folder / "before")
        effect = ["--effect", "wall_film=2", "--out", folder / "after"]
        _run("training.cli", *simulate, "--seed", 10 + seed, *effect)
    before, after = (sorted((folder / each).glob("*.parquet")) for each in ("before", "after"))
    chain = folder / "chain.onnx"
    _run("training.cli", "fit", *before, "--kind", "greybox", "--out", chain)
    call = ["gap", "--model", chain, *after, "--out", "gap", "--sensor-known-good"]
    _run("training.cli", *call, "--healthy", *before, cwd=folder)  # the page shows the path
    _gap_page(browser, folder / "gap" / "report.html")


def _gap_page(browser: Browser, report: Path) -> None:
    page = browser.new_page(viewport={"width": 990, "height": 1225})
    page.goto(report.as_uri())
    page.screenshot(path=PICTURES / "gap.png")


def _run(module: str, *words: object, may_end_with: int = 0, cwd: Path = ROOT) -> None:
    line = [sys.executable, "-m", module, *map(str, words)]
    done = subprocess.run(line, cwd=cwd, env=os.environ | {"PYTHONPATH": str(ROOT)}, check=False)
    if done.returncode not in (0, may_end_with):
        raise SystemExit(f"{module} {' '.join(map(str, words))}: exit code {done.returncode}")


if __name__ == "__main__":
    main()
