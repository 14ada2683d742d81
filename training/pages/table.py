"""One table for every page: columns of numbers stand right, long texts wrap, wide tables scroll."""

from collections.abc import Callable, Sequence
from typing import Any, Final

from training.pages.numbers import MISSING

LONG: Final = 34  # letters from which a text wraps and gets room for it
NUMBER: Final = 40  # letters of the longest number with its bounds
AMONG_NUMBERS: Final = ("", MISSING, "-", "never", "none")

Cells = Sequence[Any]


class PageTable:
    """Rows of cells under a head; in a template it stands for its HTML."""

    def __init__(
        self,
        render: Callable[..., str],
        *head: str,
        rows: Sequence[Cells] = (),
        shown: int | None = None,
    ) -> None:
        """Begin a table.

        shown : rows before the rest is folded
        """
        self._render = render
        self.head = head
        self.rows = [(tuple(cells), False) for cells in rows]
        self.shown = shown

    def row(self, *cells: Any, chosen: bool = False) -> None:
        """Add a row; a chosen one is set off."""
        self.rows.append((cells, chosen))

    @property
    def columns(self) -> list[str]:
        """The class of each column: ``n`` holds numbers, ``long`` long texts."""
        columns = zip(*(cells for cells, _ in self.rows), strict=True)
        return [("long" * _is_long(c)) if i == 0 else _class(c) for i, c in enumerate(columns)]

    def __html__(self) -> str:
        """Return the table as HTML."""
        return self._render("table.html", table=self)


def _class(cells: Cells) -> str:
    told = [str(c) for c in cells if str(c) not in AMONG_NUMBERS]
    is_text = any(c[0].isalpha() for c in told) or any(hasattr(c, "__html__") for c in cells)
    if told and not is_text and max(map(len, told)) <= NUMBER:
        return "n"
    return "long" if _is_long(cells) else ""


def _is_long(cells: Cells) -> bool:
    return any(len(str(c)) >= LONG and " " in str(c) for c in cells)
