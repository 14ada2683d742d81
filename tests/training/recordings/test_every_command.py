"""Every command that takes a recording takes the logs of tuning tools, text and binary."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from monitor.cli import main as o2mon
from tests.helpers.logs.logger_files import Field, write_mlg, write_text_table
from training.cli import main as o2train

pytestmark = pytest.mark.trains
N = 3100
PERIOD_S = 0.1
SHAPE = ("--lags", "3", "--hidden", "4", "--starts", "1", "--budget", "0.02")  # quickly trained


def columns(seed: int) -> dict[str, np.ndarray]:
    """Return a drive whose lambda follows steps of load late, in a tuner's units."""
    rng = np.random.default_rng(seed)
    load = np.repeat(rng.uniform(0.1, 0.9, N // 10), 10)
    change = np.diff(load, prepend=load[0])
    lean = np.convolve(change, 0.9 ** np.arange(30))[:N]
    return {
        "Time": PERIOD_S * np.arange(N),
        "RPM": 1500.0 + 1200.0 * load + rng.normal(0.0, 5.0, N),
        "MAP": 25.0 + 70.0 * load,
        "AFR": 14.7 * (1.0 + 0.15 * np.roll(lean, 3)) + 0.03 * rng.standard_normal(N),
        "MAT": np.full(N, 30.0) + 2.0 * np.sin(0.01 * np.arange(N)),
        "CLT": np.full(N, 88.0) + 0.1 * rng.standard_normal(N),
        "Batt V": 13.8 + 0.05 * rng.standard_normal(N),
        "EGO cor1": 100.0 + 2.0 * np.sin(0.05 * np.arange(N)),
        "PW": 1.6 + 7.0 * load + 0.02 * rng.standard_normal(N),
    }


UNITS = ("s", "RPM", "kPa", "AFR", "°C", "°C", "v", "%", "ms")


def msl(path: Path, seed: int) -> Path:
    """Write a text log of TunerStudio."""
    preamble = ('"MS2Extra comms330NP: MS2/Extra release 3.3.1"', '"Capture Date: Mon"')
    return write_text_table(
        path.with_suffix(".msl"),
        columns(seed),
        separator="\t",
        encoding="cp1252",
        units=UNITS,
        preamble=preamble,
    )


def mlg(path: Path, seed: int) -> Path:
    """Write a binary log of MegaLogViewer."""
    c = columns(seed)
    fields = [Field(name, unit.strip("°")) for name, unit in zip(c, UNITS, strict=True)]
    cells = np.column_stack(list(c.values()))
    return write_mlg(path.with_suffix(".mlg"), fields, cells, c["Time"], info='"MS2/Extra"')


def run(command: Callable[[list[str]], int], *arguments: str | Path) -> int:
    """Return the exit code; a usage error or unusable input fails the test."""
    code = command([str(each) for each in arguments])
    assert code != 2, arguments
    return code


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Give a network and a chain, made of text logs without a word of configuration."""
    folder = tmp_path_factory.mktemp("models")
    fitted = [msl(folder / f"fitted{i}", i) for i in range(2)]
    network, chain = folder / "model.onnx", folder / "chain.onnx"
    assert run(o2train, "fit", *fitted, "--out", network, *SHAPE) == 0
    assert run(o2train, "fit", *fitted, "--out", chain, "--kind", "greybox") == 0
    return network, chain


def test_every_command_takes_binary_logs(tmp_path: Path, models: tuple[Path, Path]) -> None:
    network, chain = models
    healthy = [mlg(tmp_path / f"healthy{i}", i) for i in range(2)]
    new = mlg(tmp_path / "new", 7)
    out = tmp_path / "out"
    assert run(o2mon, "check", new) == 0
    assert run(o2mon, "check", new, "--model", network) == 0
    assert run(o2train, "check", *healthy) == 0
    assert run(o2train, "evaluate", "--model", network, new) == 0
    # a model of one logger's columns judges the next log; the chain may not suffice for a verdict
    assert run(o2mon, "replay", "--model", network, new, "--quiet") in (0, 1)
    assert run(o2mon, "replay", "--model", chain, new, "--quiet") in (0, 1, 3)
    assert run(o2train, "fleet", new, "--model", network, "--out", f"{out}.parquet") in (0, 1)
    assert run(o2train, "table", new, "--out", f"{out}.csv") == 0
    assert run(o2train, "log", new, "--out", f"{out}.log") == 0
    calibrate = ("--model", network, "--healthy", *healthy)
    assert run(o2train, "calibrate", *calibrate, "--out", f"{out}.onnx") == 0
    assert run(o2train, "tables", *healthy, "--out", f"{out}_tables") in (0, 3)
    both = ("--healthy", *healthy, "--out", f"{out}_gap")
    assert run(o2train, "gap", "--model", chain, new, *both) in (0, 1, 3)
