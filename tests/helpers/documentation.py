"""Blocks of shell commands in the pages, and why one is not run.

A comment above a block says why: ``<!-- not run: needs a bus -->``. With words before a colon it
holds for the lines with one of these words: ``<!-- not run: can0, candump: needs a bus -->``.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SHELL = ("sh", "bash", "console")
BLOCK = re.compile(
    r"(?:^<!-- not run: (?P<reason>.*?) -->\n)?^```(?P<language>\w*)\n(?P<text>.*?)^```",
    re.S | re.M,
)


@dataclass(frozen=True, slots=True)
class Block:
    """A block of shell commands."""

    page: Path
    line: int
    text: str
    reason: str | None  # why it is not run, or a part of it

    @property
    def place(self) -> str:
        return f"{self.page.name}:{self.line}"

    def skipped(self, command: str) -> bool:
        """Return whether the reason holds for a command of the block."""
        if self.reason is None:
            return False
        words, colon, _ = self.reason.partition(": ")
        return not colon or any(word in command for word in words.split(", "))


def pages(root: Path) -> list[Path]:
    """Return README and all pages below docs/."""
    return [root / "README.md", root / "SECURITY.md", *sorted((root / "docs").rglob("*.md"))]


def blocks(page: Path) -> Iterator[Block]:
    """Yield the blocks of shell commands of a page."""
    text = page.read_text()
    for match in BLOCK.finditer(text):
        if match["language"] in SHELL:
            line = text[: match.start("text")].count("\n")
            yield Block(page, line, match["text"], match["reason"])


def commands(text: str) -> list[str]:
    """Return the commands of a block, each on one line; comments and continuations are gone."""
    joined = re.sub(r"\\\n\s*", " ", text)
    lines = [line.strip() for line in joined.splitlines()]
    return [line for line in lines if line and not line.startswith("#")]
