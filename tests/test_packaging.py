"""The installed wheel is complete, works outside the tree and needs no library of training."""

import os
import re
import shutil
import subprocess
import sys
from configparser import ConfigParser
from itertools import pairwise
from pathlib import Path

import pytest
import yaml

from tests.conftest import ROOT

SOURCES = (
    "pyproject.toml",
    "README.md",
    "LICENSE",
    "NOTICE",
    "share",
    "monitor",
    "training",
    "dbc",
)
ABSENT = (
    *("pytest", "training", "torch", "scipy", "numba", "polars", "pandas", "onnx", "joblib"),
    "asammdf",  # python-can takes it where it is, and it brings pandas
    *("fcntl", "resource", "termios"),  # Windows has none of them
)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder outside the tree in which the built wheel is installed."""
    work = tmp_path_factory.mktemp("wheel")
    tree = work / "tree"  # a copy: a build leaves files behind, and takes old ones in
    for name in SOURCES:
        tree.mkdir(exist_ok=True)
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(ROOT / name, tree / name)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    build = ["wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(work), str(tree)]
    run([*pip, *build], cwd=work)
    (wheel,) = work.glob("o2_monitor-*.whl")
    target = work / "installed"
    options = ["--no-deps", "--no-index", "--no-compile", "--target", str(target)]
    run([*pip, "install", *options, str(wheel)], cwd=work)
    return target


def test_every_file_of_the_packages_is_installed(installed: Path) -> None:
    for folder in ("monitor", "training", "dbc", "share/bash-completion"):
        files = {path for path in (ROOT / folder).rglob("*") if path.is_file()}
        wanted = {path for path in files if "__pycache__" not in path.parts}
        lacking = {path for path in wanted if not (installed / path.relative_to(ROOT)).exists()}
        assert wanted
        assert not lacking


def test_the_lock_file_has_hashes_of_every_pinned_package_but_torch() -> None:
    pins = {line for line in (ROOT / "constraints.txt").read_text().split() if "==" in line}
    lines = (ROOT / "requirements-dev.lock").read_text().splitlines()
    locked = {line.split()[0] for line in lines if "==" in line}
    assert {normal(pin) for pin in pins if not pin.startswith("torch==")} == set(
        map(normal, locked)
    )
    for before, line in pairwise(lines):
        if "==" in before:
            assert re.match(r"    --hash=sha256:[0-9a-f]{64}", line), before


def normal(pin: str) -> str:
    name, version = pin.split("==")
    return f"{re.sub('[-_.]+', '-', name).lower()}=={version}"


def test_an_installed_monitor_replays_with_defaults(installed: Path, tmp_path: Path) -> None:
    logs = sorted((ROOT / "replay_logs").glob("healthy_*"))
    assert logs, "replay_logs/ has no healthy drive"
    finished = python(installed, ["-m", "monitor.cli", "replay", str(logs[0])], cwd=tmp_path)
    assert finished.stdout


def test_the_installed_commands_are_those_installed(installed: Path, tmp_path: Path) -> None:
    (points,) = installed.glob("o2_monitor-*.dist-info/entry_points.txt")
    commands = ConfigParser()
    commands.read(points)
    scripts = dict(commands["console_scripts"])
    assert scripts.keys() == {"o2mon", "o2train"}
    for name, place in scripts.items():
        module, function = place.split(":")
        script = f"import sys, {module} as own; print(own.__file__); own.{function}(['--version'])"
        found, version = python(installed, ["-c", script], cwd=tmp_path).stdout.splitlines()
        assert Path(found).is_relative_to(installed)
        assert version.startswith(f"{name} ")


def test_the_runtime_starts_where_no_library_of_training_exists(tmp_path: Path) -> None:
    # GIVEN a Python in which training and its libraries cannot be imported
    # WHEN every module of the runtime is imported
    script = (
        f"import sys; sys.modules.update(dict.fromkeys({ABSENT!r}))\n"
        "import importlib, pkgutil, monitor, dbc\n"
        "for module in pkgutil.walk_packages(monitor.__path__, 'monitor.'):\n"
        "    if not module.name.endswith(('__main__', '.pytest_plugin')):\n"
        "        importlib.import_module(module.name)\n"
        "        print(module.name)"
    )
    imported = python(ROOT, ["-c", script], cwd=tmp_path).stdout.split()
    # THEN it works, for all of them
    paths = {path.relative_to(ROOT) for path in (ROOT / "monitor").rglob("[!_]*.py")}
    paths -= {Path("monitor/api/pytest_plugin.py")}  # pytest itself imports it
    assert {".".join(path.with_suffix("").parts) for path in paths} <= set(imported)


def test_both_ci_files_of_the_firmware_example_have_one_command(installed: Path) -> None:
    firmware = ROOT / "examples" / "firmware"
    job = yaml.safe_load((firmware / "gitlab.yml").read_text())["diagnosis"]
    steps = yaml.safe_load((firmware / "github.yml").read_text())["jobs"]["diagnosis"]["steps"]
    command = job["script"][-1]
    assert command in [step.get("run") for step in steps]
    # the wheel's entry point is all that pytest knows of the monitor; its run needs an idle machine
    words = [*command.split(), "--collect-only", "-q", "-p", "no:cacheprovider"]
    found = python(installed, ["-m", *words], cwd=firmware)
    assert "6 tests collected" in found.stdout


def test_a_drive_is_judged_where_the_system_has_no_file_locks(tmp_path: Path) -> None:
    # GIVEN a Python as on another system: without fcntl, msvcrt and the flags of POSIX
    script = (
        "import os, sys; sys.modules.update(fcntl=None, msvcrt=None, resource=None, termios=None)\n"
        "for name in ('O_NONBLOCK', 'O_NOCTTY', 'pwrite', 'sched_setscheduler', 'killpg'):\n"
        "    delattr(os, name)\n"
        "from monitor.cli import main\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    log = next((ROOT / "replay_logs").glob("healthy_micro*"))
    # WHEN a drive is judged THEN the verdict is the usual one
    finished = python(ROOT, ["-c", script, "replay", str(log)], cwd=tmp_path)
    assert "no fault" in finished.stdout
    # and a fault memory is refused with one line
    with_memory = [sys.executable, "-c", script, "replay", str(log), "--memory", "o2.db"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    refused = subprocess.run(
        with_memory, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert refused.returncode == 2
    assert refused.stderr.splitlines() == [
        "o2mon: o2.db: this system has no file locks, so no fault memory can be used"
    ]


def python(path: Path, arguments: list[str], cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run Python with ``path`` before all others; a non-zero exit fails the test."""
    return run([sys.executable, *arguments], cwd=cwd, env={**os.environ, "PYTHONPATH": str(path)})


def run(
    command: list[str], cwd: Path, env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    finished = subprocess.run(
        command, cwd=cwd, env=env, capture_output=True, text=True, check=False
    )
    assert finished.returncode == 0, finished.stdout + finished.stderr
    return finished
