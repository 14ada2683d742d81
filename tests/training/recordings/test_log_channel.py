"""A log of two buses on which the same identifiers mean two things, in every command that reads."""

import shutil
from pathlib import Path

import polars as pl
import pytest

import dbc
from monitor.cli import main as o2mon
from training.cli import main as o2train
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment

MODEL = str(Path(dbc.__file__).parents[1] / "monitor" / "model" / "shipped.onnx")


@pytest.fixture(scope="module")
def two_buses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a drive on can0 with other frames of the same identifiers on can1."""
    folder = tmp_path_factory.mktemp("two")
    lines = write(Experiment(duration_s=30.0), folder, "log").read_text().splitlines()
    (name,) = {line.split()[1] for line in lines}
    other = [f"{line.replace(name, 'can1').split('#')[0]}#0000000000000000" for line in lines]
    both = "\n".join(v for pair in zip(lines, other, strict=True) for v in pair)
    path = folder / "both" / "two.log"
    path.parent.mkdir()
    path.write_text(both.replace(f" {name} ", " can0 ") + "\n")
    return path


@pytest.mark.parametrize(
    "command",
    [
        "o2mon inject LOG --out OUT.log --fault gain_low=0.5",
        f"o2mon map {dbc.path('o2_ecu.dbc')} --log LOG --out OUT.toml",
        "o2mon check LOG",
        "o2train table LOG --out OUT.csv",
        "o2train check LOG",
    ],
)
def test_a_command_refuses_a_mixture_of_buses_and_reads_the_named_one(
    two_buses: Path, tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = command.replace("LOG", str(two_buses)).replace("OUT", str(tmp_path / "out")).split()
    main = {"o2mon": o2mon, "o2train": o2train}[words[0]]
    assert main(words[1:]) == 2
    assert "is on the channels 'can0' and 'can1'" in "".join(capsys.readouterr())
    assert main([*words[1:], "--channel", "can7"]) == 2
    assert "no channel can7" in "".join(capsys.readouterr())
    assert main([*words[1:], "--channel", "can0"]) in (0, 2, 3)
    said = "".join(capsys.readouterr())
    assert "is on the channels" not in said and "has no channel" not in said
    for out in tmp_path.glob("out.*"):
        assert "can1" not in out.read_text()


def test_a_fleet_reads_the_named_channel(two_buses: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(two_buses.parent, tmp_path / "drives")
    words = ["fleet", str(folder), "--model", MODEL, "--jobs", "1", "--out"]
    mixed, chosen = tmp_path / "mixed.parquet", tmp_path / "chosen.parquet"
    o2train([*words, str(mixed)])
    o2train([*words, str(chosen), "--channel", "can0"])
    errors = [pl.read_parquet(path)["error"][0] for path in (mixed, chosen)]
    assert "is on the channels 'can0' and 'can1'" in errors[0]
    assert not errors[1]
