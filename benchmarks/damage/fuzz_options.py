"""Options that every fuzzer has."""

from argparse import ArgumentParser
from pathlib import Path

KEEP = Path("build/fuzz")


def fuzz_parser(doc: str | None, of: str, number: int, *, keeps: bool = False) -> ArgumentParser:
    """Return a parser with ``--OF`` (how many, by default ``number``) and ``--seed``.

    doc : of the fuzzer's file
    keeps : the fuzzer keeps inputs that break a promise, in the folder ``--keep``
    """
    parser = ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument(f"--{of}", type=int, default=number)
    parser.add_argument("--seed", type=int, default=1)
    if keeps:
        parser.add_argument("--keep", type=Path, default=KEEP, help="failures go here")
    return parser
