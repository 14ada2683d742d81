"""Draw the rooms of the house from the imports in the code: docs/pictures/rooms.svg.

A room is a package directly below ``monitor`` or ``training``. The rooms stand in the order of the
``layers`` contracts in pyproject.toml, which is the order of the data. An arc joins a room with
every room that it imports; its width grows with the number of importing lines. An import against
the order would be drawn in red on the left.

    python docs/site/rooms.py            write the picture, print lines and imports of each room
"""

import math
import tomllib
from collections import Counter
from html import escape
from pathlib import Path
from typing import Final

import grimp

ROOT: Final = Path(__file__).resolve().parents[2]
PICTURE: Final = ROOT / "docs" / "pictures" / "rooms.svg"
ROW: Final = 46  # px from one room to the next
BOX_WIDTH, BOX_HEIGHT, COLUMN = 520, 36, 720  # px
LEFT, TOP = 40, 90  # px, around the drawing

Edges = Counter[tuple[str, str]]  # (importing room, imported room) -> lines that import


def orders() -> dict[str, list[str]]:
    """Return the rooms of each package, first in the data flow first."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contracts = settings["tool"]["importlinter"]["contracts"]
    return {
        contract["containers"][0]: contract["layers"][::-1]
        for contract in contracts
        if contract["type"] == "layers" and contract["containers"][0] in ("monitor", "training")
    }


def imports() -> Edges:
    """Return how many lines of a room import each other room."""
    graph = grimp.build_graph("monitor", "training", "dbc")
    edges: Edges = Counter()
    for module in graph.modules:
        for imported in graph.find_modules_directly_imported_by(module):
            pair = _room(module), _room(imported)
            if pair[0] and pair[1] and pair[0] != pair[1]:
                details = graph.get_import_details(importer=module, imported=imported)
                edges[pair] += len({detail["line_number"] for detail in details})
    return edges


def lines_of(room: str) -> int:
    """Return the lines of Python in a room, for example in ``monitor.judge``."""
    paths = (ROOT / room.replace(".", "/")).rglob("*.py")
    return sum(len(path.read_text().splitlines()) for path in paths)


def picture(order: dict[str, list[str]], edges: Edges) -> str:
    """Return the SVG with one column of rooms for each package."""
    height = TOP + ROW * max(len(rooms) for rooms in order.values()) + 60
    width = LEFT + COLUMN * len(order)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        'font-family="system-ui, sans-serif" font-size="14">',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for number, (package, rooms) in enumerate(order.items()):
        x = LEFT + number * COLUMN
        parts.append(f'<text x="{x}" y="48" font-size="22" font-weight="600">{package}/</text>')
        note = "each room imports only rooms above it"
        parts.append(f'<text x="{x}" y="70" fill="#57606a">{note}</text>')
        parts += _arcs(x + BOX_WIDTH, package, rooms, edges)
        parts += [_box(x, TOP + i * ROW, f"{package}.{room}") for i, room in enumerate(rooms)]
    return "\n".join([*parts, "</svg>", ""])


def _room(module: str) -> str:
    """Return the room of a module, an empty string for the faces of the packages."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] in ("monitor", "training") and len(parts) > 1 else ""


def _box(x: int, y: int, room: str) -> str:
    face = (ROOT / room.replace(".", "/") / "__init__.py").read_text()
    says = face.removeprefix('"""').split("\n")[0].removesuffix('"""').replace("`", "").rstrip(".")
    name = room.split(".")[1]
    return (
        f'<rect x="{x}" y="{y}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="5" '
        'fill="#eef4fb" stroke="#0969da"/>'
        f'<text x="{x + 10}" y="{y + 16}" font-weight="600">{name}</text>'
        f'<text x="{x + 10}" y="{y + 30}" font-size="11" fill="#424a53">{escape(says)}</text>'
    )


def _arcs(x: int, package: str, rooms: list[str], edges: Edges) -> list[str]:
    """Return the arcs between the rooms of one package, right of their boxes."""
    found = []
    for (importing, imported), n in sorted(edges.items()):
        names = [room.removeprefix(f"{package}.") for room in (importing, imported)]
        if not all(name in rooms for name in names):
            continue
        below, above = (rooms.index(name) for name in names)
        is_against = above > below
        y1, y2 = (TOP + i * ROW + BOX_HEIGHT / 2 for i in (below, above))
        reach = 12 + 20 * abs(below - above) ** 0.85
        side = x - BOX_WIDTH - reach if is_against else x + reach
        start = x - BOX_WIDTH if is_against else x
        colour = "#cf222e" if is_against else "#6e7781"
        found.append(
            f'<path d="M {start} {y1} C {side} {y1} {side} {y2} {start} {y2}" fill="none" '
            f'stroke="{colour}" stroke-opacity="0.55" '
            f'stroke-width="{0.6 + math.log2(1 + n) * 0.45:.2f}">'
            f"<title>{importing} imports {imported}: {n} lines</title></path>"
        )
    return found


def main() -> None:
    """Write the picture and print a line about each room."""
    order, edges = orders(), imports()
    PICTURE.parent.mkdir(exist_ok=True)
    PICTURE.write_text(picture(order, edges))
    for package, rooms in order.items():
        for room in (f"{package}.{name}" for name in rooms):
            users = sorted(
                {a.split(".")[1] for a, b in edges if b == room and a.startswith(package)}
            )
            print(f"{room:22} {lines_of(room):6} lines, imported by {', '.join(users) or 'none'}")


if __name__ == "__main__":
    main()
