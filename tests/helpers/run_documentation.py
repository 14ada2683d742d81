"""Run every command of the documentation: ``make test-docs`` (some minutes).

    python -m tests.helpers.run_documentation [PAGE …]

Each page has a scratch folder with the files that its commands name: simulated drives, databases,
a model. A block is run line by line in one shell, unless a comment above it says why not:
``<!-- not run: needs a bus -->``, or for the lines with some words,
``<!-- not run: can0, candump: needs a bus -->``. A command may end with 0, ``o2mon`` also with a
verdict (1) or without one (3). A training is cut short by a wrapper: what counts is that the
command works as written.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHELL = ("sh", "bash", "console")
BLOCK = re.compile(
    r"(?:^<!-- not run: (?P<reason>.*?) -->\n)?^```(?P<language>\w*)\n(?P<text>.*?)^```",
    re.S | re.M,
)
SECONDS = 600  # most for a line
MAPS = re.compile(r"--out (\S+\.toml)")
DRIVES = ("drive1", "drive2", "drive3", "drive4", "drive9")
SIMULATED = {  # stem -> options; CAN logs
    **{name: f"--seed {seed} --downstream" for seed, name in enumerate(DRIVES, 1)},
    "drive": "--seed 6 --downstream",
    "healthy1": "--seed 11",
    "healthy2": "--seed 12",
    "other1": "--seed 13",
    "late1": "--seed 14 --fault delay_rich_to_lean=0.6",
    "old1": "--seed 15",
    "old2": "--seed 16 --cycle wltc_3b",
    "old3": "--seed 19 --cycle us06",
    "new1": "--seed 17 --effect wall_film=4",
    "new2": "--seed 18 --effect wall_film=4 --cycle wltc_3b",
    "new3": "--seed 20 --effect wall_film=4 --cycle us06",
}
RENAMED = {  # columns of a recording with other names
    "engine_speed_rpm": "speed",
    "air_mass_mg": "load",
    "throttle_percent": "ignition",
    "lambda_measured": "lambda_z",
}
SHORT = {  # command -> options that cut it short
    "fit": "--budget 0.2 --starts 1 --lags 3 --hidden 4",
    "study": "--budget 0.1 --starts 1 --iterations 10 --samples 1500 --models 1 2 --jobs 1",
}
WRAPPER = """#!/bin/sh
command=$1; shift
case "$*" in *greybox*) short= ;; *) case $command in
{cases} *) short= ;; esac ;; esac
exec {program} $command "$@" $short
"""


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


def shared_files(folder: Path) -> None:
    """Make the files that pages take from, once for all pages."""
    folder.mkdir()
    simulate = [f"{Path(sys.executable).parent}/o2train", "simulate", "--cycle", "micro_trips"]
    for name, options in SIMULATED.items():
        for form in ("log", "blf") if name[:3] not in ("old", "new") else ("log",):
            work = folder / "work"
            call = [*simulate, "--out", str(work), "--duration", "420", "--format", form]
            subprocess.run([*call, *options.split()], check=True, capture_output=True)
            (made,) = work.glob(f"*.{form}")
            made.rename(folder / f"{name}.{form}")
            shutil.rmtree(work)
    for name in ("drive3.parquet", "wltc.parquet", "slow.parquet", "run_1.csv", "run_2.csv"):
        stem = Path(name).stem
        log = folder / ("drive4.log" if stem == "run_2" else "drive3.log")
        table = [simulate[0], "table", str(log), "--out", str(folder / name)]
        subprocess.run(table, check=True, capture_output=True)
        if stem.startswith("run"):
            text = (folder / name).read_text()
            for old, new in RENAMED.items():
                text = text.replace(old, new)
            (folder / name).write_text(text)
    port = "--injection port --format csv --period 0.05 --duration 900 --cycle micro_trips"
    for seed, day in enumerate(("monday", "tuesday", "wednesday", "thursday", "friday"), 1):
        work = folder / "work"
        call = [simulate[0], "simulate", "--out", str(work), "--seed", str(seed), *port.split()]
        subprocess.run(call, check=True, capture_output=True)
        (made,) = work.glob("*.csv")
        to_msl(made, folder / f"{day}.msl")
        shutil.rmtree(work)
    shutil.copy(ROOT / "monitor/model/shipped.onnx", folder / "mine.onnx")
    for name in ("model", "car", "own"):
        shutil.copy(folder / "mine.onnx", folder / f"{name}.onnx")
    for kind in ("dbc", "toml"):
        shutil.copy(ROOT / f"dbc/o2_ecu.{kind}", folder / f"engine.{kind}")
    logs = folder / "logs" / "2026-01"
    logs.mkdir(parents=True)
    for number, name in enumerate(DRIVES[:2]):
        shutil.copy(folder / f"{name}.blf", logs / f"car_{number}.blf")
    (folder / "manifest.csv").write_text("path,vehicle\ndrive1.blf,A\ndrive2.blf,B\n")


def to_msl(table: Path, place: Path) -> None:
    """Write a table of a simulated tuner's log as TunerStudio does."""
    names = {
        "time_s": "Time",
        "engine_speed_rpm": "RPM",
        "manifold_pressure_kpa": "MAP",
        "injector_pulse_width_ms": "PW",
        "lambda_measured": "Lambda",
        "coolant_temperature_degc": "CLT",
        "manifold_temperature_degc": "MAT",
        "battery_voltage_v": "Batt V",
        "throttle_percent": "TPS",
    }
    head, *rows = (line.split(",") for line in table.read_text().splitlines())
    kept = [index for index, name in enumerate(head) if name in names]
    lines = [[names[head[index]] for index in kept], *([row[i] for i in kept] for row in rows)]
    place.write_text('"MS3 Format 0523.00"\n' + "\n".join("\t".join(line) for line in lines) + "\n")


def programs(folder: Path) -> None:
    """Put the commands in a folder for PATH; training is cut short, pip installs nothing."""
    folder.mkdir()
    own = Path(sys.executable).parent
    for name in ("o2mon", "python"):
        write(folder / name, f'#!/bin/sh\nexec {own / name} "$@"\n')
    cases = "\n".join(f'{command}) short="{options}" ;;' for command, options in SHORT.items())
    write(folder / "o2train", WRAPPER.format(cases=cases, program=own / "o2train"))
    pip = f'cd {ROOT} && exec {own / "python"} -m pip "$1" --dry-run --no-deps -q "$2"'
    write(folder / "pip", f"#!/bin/sh\n{pip}\n")


def write(place: Path, text: str) -> None:
    place.write_text(text)
    place.chmod(0o755)


def script(block: Block) -> str:
    """Return a shell script that ends with the first command that fails."""
    lines = ["set -u", "DBC=$(python -c \"import dbc; print(dbc.path('rusefi.dbc').parent)\")"]
    for command in commands(block.text):
        if block.skipped(command) or "activate" in command:  # it runs in an environment already
            continue
        verdicts = "0|1|3" if command.startswith("o2mon") else "0"
        check = f"code=$?; case $code in {verdicts}) ;; *) echo exit $code >&2; exit 9 ;; esac"
        lines += [f"echo '+ '{shlex.quote(command)}", command, check]
    return "\n".join(lines)


def main() -> int:
    """Run the pages' commands; return 1 if one failed."""
    wanted = [Path(name).resolve() for name in sys.argv[1:]] or pages(ROOT)
    failed = []
    with tempfile.TemporaryDirectory(prefix="o2_docs_") as name:
        scratch = Path(name)
        shared_files(scratch / "files")
        programs(scratch / "bin")
        path = f"{scratch / 'bin'}:{os.environ['PATH']}"
        environment = {**os.environ, "PATH": path, "OMP_NUM_THREADS": "1"}
        for page in wanted:
            work = scratch / page.stem
            shutil.copytree(scratch / "files", work)
            for part in ("replay_logs", "docs"):
                (work / part).symlink_to(ROOT / part)
            for block in blocks(page):
                text = script(block)
                if text.count("\n") < 2:
                    print(f"{block.place}: not run: {block.reason}", flush=True)
                    continue
                for made in MAPS.findall(block.text):  # a map is never overwritten
                    (work / made).unlink(missing_ok=True)
                finished = subprocess.run(
                    ["sh", "-c", text],
                    cwd=work,
                    env=environment,
                    capture_output=True,
                    text=True,
                    timeout=SECONDS,
                    check=False,
                )
                outcome = "FAILS" if finished.returncode else "runs"
                print(f"{block.place}: {outcome}", flush=True)
                if finished.returncode:
                    failed.append(block.place)
                    print(finished.stdout[-2000:], finished.stderr[-2000:], flush=True)
            shutil.rmtree(work)
    print(f"{len(failed)} blocks failed: {', '.join(failed)}" if failed else "all blocks run")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
