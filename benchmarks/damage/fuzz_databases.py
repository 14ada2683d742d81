"""Fuzz CAN databases, signal maps and settings: ``o2mon check``, ``replay`` and ``map``.

A shipped database (DBC, KCD, SYM or ARXML) and its map get something wrong: numbers that no bus
has, multiplexers that lead nowhere or in circles, ranges without end, elements and entities out of
place, keys of another type, broken text. A crash, exit code 4, a hang of more than 5 s, more than
500 MB and a failure without its line are failures; their files are kept.
"""

import functools
import random
import re
import shutil
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import cantools

import dbc
from benchmarks.damage.harness import Job, Tally, calls, fuzz_options
from benchmarks.damage.log_seeds import DRIVE
from benchmarks.damage.mutations import TEXT, lines_of_order
from benchmarks.outcome import finish, say
from monitor import cli
from monitor.frames.logs import read_frames
from monitor.inject.gateway import write_log

MOST_MB = 500.0
PAIRS = {  # formats by database; cantools' writers take no multiplexed messages
    "o2_ecu": ("dbc", "kcd", "sym"),
    "rusefi": ("dbc", "kcd", "sym"),
    "wideband": ("dbc", "kcd", "sym", "arxml"),
    "obd2": ("dbc", "kcd"),
}
BATCH = 100
SIZES = "0 -1 1 2 7 8 9 16 17 63 64 65 100 1000 100000 10000000 4294967295 2147483648"
OTHERS = "1e400 -1e400 1e-400 0.0 nan inf 1e308 -0 99999999999999999999 0x10 1.5"
NUMBERS = (*SIZES.split(" "), *OTHERS.split(" "), "9" * 5000)
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_ELEMENT = re.compile(r"</?[^<>]{1,200}>|\b\w+=\"[^\"]*\"|\b(?:Sig|Type|Len|Mux|ID)=[^ \r\n]*")
_SIGNAL = re.compile(r"^( SG_ \w+)\s*(?:[mM]\w*)?\s*:", re.MULTILINE)
TOML = (
    *(['"text"', "true", "nan", "-inf", "[]", "{}", "0", "-1", "1e308", "1979-05-27", '"""']),
    *("0x" + "f" * 5000, "[" * 3000, "9" * 5000),
    *('{ message = "M", signal = "S" }', '"\\u0000\\n"'),
)


@functools.cache
def database_text(name: str, kind: str) -> str:
    """Return a shipped database in a format."""
    if kind == "arxml":  # which cantools does not write
        return Path(__file__).with_name(f"{name}.arxml").read_text()
    if kind == "dbc":
        return dbc.path(f"{name}.dbc").read_text("cp1252")
    database = cantools.database.load_file(dbc.path(f"{name}.dbc"))
    assert isinstance(database, cantools.database.Database)
    return database.as_kcd_string() if kind == "kcd" else database.as_sym_string()


def numbers(text: str, rng: random.Random) -> str:
    """Return a text with some numbers replaced."""
    places = list(_NUMBER.finditer(text))
    for place in sorted(
        rng.sample(places, min(len(places), rng.choice((1, 1, 3, 20)))),
        key=re.Match.start,
        reverse=True,
    ):
        text = text[: place.start()] + rng.choice(NUMBERS) + text[place.end() :]
    return text


def multiplexers(text: str, rng: random.Random) -> str:
    """Return a database whose signals come under multiplexers that may not be there."""

    def marked(match: re.Match[str]) -> str:
        mark = rng.choice(("M", "m0", "m3M", "m99999999", f"m{rng.randrange(300)}", "", "", ""))
        return f"{match[1]} {mark} :"

    text = _SIGNAL.sub(marked, text)
    names = re.findall(r"^ SG_ (\w+)", text, re.MULTILINE)
    messages = re.findall(r"^BO_ (\d+)", text, re.MULTILINE)
    for _ in range(rng.randrange(6) if names and messages else 0):
        first = rng.choice(("0", "3", "10000000", "9" * 30))
        last = rng.choice(("0", "3", "65535", "10000000", "4294967295"))
        text += (
            f"SG_MUL_VAL_ {rng.choice(messages)} {rng.choice(names)} {rng.choice(names)} "
            f"{first}-{last};\n"
        )
    return text


def floats(text: str, rng: random.Random) -> str:
    """Return a database some of whose signals are floats."""
    message = ""
    for line in text.splitlines():
        if found := re.match(r"BO_ (\d+)", line):
            message = found[1]
        elif (found := re.match(r" SG_ (\w+)", line)) and rng.random() < 0.3:
            text += f"SIG_VALTYPE_ {message} {found[1]} : {rng.choice((1, 2, 3))};\n"
    return text


def elements(text: str, rng: random.Random) -> str:
    """Return a text with tags, attributes or keywords left out, doubled, changed or nested."""
    words = list(_ELEMENT.finditer(text))
    for place in sorted(rng.sample(words, min(len(words), rng.choice((1, 1, 4)))), key=_end)[::-1]:
        other = rng.choice(words)[0]
        with_ = rng.choice(("", other, place[0] * 2, place[0] * 3000, f"{place[0]}{other}"))
        text = text[: place.start()] + with_ + text[place.end() :]
    return text


def _end(match: re.Match[str]) -> int:
    return match.end()


def entities(text: str, rng: random.Random) -> str:
    """Return an XML text with entities that grow or that name a file."""
    grown = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    bomb = f'<!DOCTYPE r [<!ENTITY e0 "{"x" * 100}">{grown}]>'
    outside = '<!DOCTYPE r [<!ENTITY e11 SYSTEM "file:///etc/passwd">]>'
    head, mark, rest = text.partition("?>") if "?>" in text else ("", "", text)
    at = rng.choice([m.end() for m in re.finditer(">", rest)] or [0])
    return head + mark + rng.choice((bomb, outside)) + rest[:at] + "&e11;" + rest[at:]


def broken(text: str, rng: random.Random) -> str:
    """Return a text with bytes, numbers or lines wrong."""
    mutate = rng.choice((*TEXT, lines_of_order))
    return mutate(bytearray(text.encode("latin-1", "replace")), rng).decode("latin-1")


def values(text: str, rng: random.Random) -> str:
    """Return a TOML text with values of other types, or keys and tables twice or elsewhere."""
    lines = text.splitlines()
    for _ in range(rng.choice((1, 1, 3))):
        row = rng.randrange(len(lines))
        key, sign, value = lines[row].partition("=")
        if sign and rng.random() < 0.5:
            lines[row] = f"{key}= {rng.choice(TOML)}"
        elif sign:
            lines[row] = f"{key}= " + re.sub(
                r"= *[^,}]+",
                lambda m: m[0] if rng.random() < 0.6 else f"= {rng.choice(TOML)} ",
                value,
            )
        else:
            lines.insert(row, rng.choice(lines))
    return "\n".join(lines) + "\n"


Way = Callable[[str, random.Random], str]
XML: tuple[Way, ...] = (*[numbers] * 2, *[elements] * 2, entities, broken)
WAYS: dict[str, tuple[Way, ...]] = {
    "dbc": (*[numbers] * 3, *[multiplexers] * 2, floats, broken),
    "kcd": XML,
    "arxml": XML,
    "sym": (*[numbers] * 2, elements, broken),
}
SETTINGS: tuple[Way, ...] = (numbers, *[values] * 2, broken)


def case(folder: Path, number: int, rng: random.Random, log: Path) -> list[str]:
    """Write a damaged pair or settings file; return the arguments of the command to run."""
    name = rng.choice(list(PAIRS))
    form = rng.choice(PAIRS[name])
    texts = {form: database_text(name, form), "toml": dbc.path(f"{name}.toml").read_text()}
    settings = Path(cli.__file__).parents[1] / "base" / "default.toml"
    wrong = rng.choices((form, "toml", "config"), (7, 2, 1))[0]
    if wrong == "config":
        path = folder / f"{number}.config.toml"
        path.write_text(rng.choice(SETTINGS)(settings.read_text(), rng), "latin-1", "replace")
        return ["replay", "--quiet", str(log), "--config", str(path)]
    for _ in range(rng.choice((1, 1, 2))):
        texts[wrong] = rng.choice(WAYS.get(wrong, SETTINGS))(texts[wrong], rng)
    paths = [folder / f"{number}.{kind}" for kind in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        path.write_text(text, "latin-1", "replace")
    if rng.random() < 0.2:
        return ["map", str(paths[0])]
    both = ["--dbc", str(paths[0]), "--map", str(paths[1])]
    return rng.choice((["check", str(log), *both], ["replay", "--quiet", str(log), *both]))


def fuzz(n: int, seed: int, keep: Path) -> Tally:
    """Run commands with ``n`` damaged files; return the counts. Failures go to ``keep``."""
    rng, tally = random.Random(seed), Tally(most_mb=MOST_MB)
    with TemporaryDirectory() as name:
        folder = Path(name)
        log = folder / "drive.log"
        write_log(log, islice(read_frames(DRIVE), 300))
        with redirect_stdout(None):  # once, for all children
            for command in (["replay", "--quiet", str(log)], ["check", str(log)]):
                cli.main(command)
        for first in range(0, n, BATCH):
            commands = [case(folder, i, rng, log) for i in range(first, min(first + BATCH, n))]
            jobs: list[Job] = [functools.partial(cli.main, words) for words in commands]
            for i, outcome in enumerate(calls(jobs), first):
                found = tally.add(outcome)
                for path in folder.glob(f"{i}.*"):
                    if found:
                        shutil.copy(path, keep / f"{seed}_{path.name}")
                    path.unlink()
                if found:
                    say(f"{', '.join(found)}: {i} {commands[i - first][0]} {outcome}")
            if (first + BATCH) % 1000 == 0:
                say(f"{first + BATCH} files")
    return tally


def main(argv: Sequence[str]) -> int:
    """Fuzz and count; return 1 if a promise was broken."""
    args = fuzz_options(__name__, __doc__, 10_000, 50).parse_args(argv)
    args.keep.mkdir(parents=True, exist_ok=True)
    tally = fuzz(args.cases, args.seed, args.keep)
    return finish(args, [tally.row("databases, maps and settings")], tally.missed())
