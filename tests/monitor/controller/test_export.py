"""The exported C compiles everywhere without a warning, and its network is the model's."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from monitor import cli
from monitor.base.files.outputs import is_own
from monitor.controller import network
from monitor.controller.export import FILES
from monitor.model.graph_bounds import Node, StepGraph
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.models import c_monitor
from tests.helpers.models.c_monitor import STRICT

COMPILERS = ("gcc", "clang")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("c") / "o2c"
    assert cli.main(["export-c", "--out", str(folder)]) == 0
    return folder


@pytest.mark.parametrize("compiler", COMPILERS)
def test_it_compiles_and_judges_a_table(compiler: str, exported: Path, tmp_path: Path) -> None:
    if not shutil.which(compiler):
        pytest.skip(f"needs {compiler}")
    files, out = sorted(exported.glob("*.c")), tmp_path / "example"
    subprocess.run([compiler, *STRICT, "-O1", "-o", out, *files, "-lm"], check=True)
    # GIVEN a table in which the engine runs and the sensor's reading is frozen
    table = tmp_path / "frozen.csv"
    names = ["lambda_measured", "engine_speed_rpm", "sensor_ready", "fuel_cut"]
    table.write_text(",".join(names) + "\n" + "1.0,2000,1,0\n" * 250)
    # WHEN the example judges it
    said = subprocess.run([out, table], capture_output=True, text=True, check=False)
    # THEN the code of a frozen sensor is pending after two stretches of 10 s
    assert said.returncode == 1
    assert "19.90 s code P0134 stuck_at_one status 0x27" in said.stdout
    # AND a cell that is no number is no value, as an empty one
    heard = []
    for cell in ("", "n/a"):
        table.write_text(",".join(names) + "\n" + "1.0,2000,1,0\n" + f"{cell},2000,1,0\n" * 250)
        heard.append(subprocess.run([out, table], capture_output=True, text=True, check=False))
    assert heard[1].stdout == heard[0].stdout
    assert "0 of 251 samples enabled, fault flag 1\n" in heard[0].stdout  # no input of the model
    lost = subprocess.run([out, tmp_path / "no.csv"], capture_output=True, text=True, check=False)
    assert (lost.returncode, lost.stderr) == (2, "example: cannot read the table\n")
    # and a table without the sensor is no silent sensor
    table.write_text("engine_speed_rpm\n" + "2000\n" * 250)
    blind = subprocess.run([out, table], capture_output=True, text=True, check=False)
    assert (blind.returncode, blind.stdout) == (2, "")
    assert "example: no column lambda_measured, nothing to judge\n" in blind.stderr
    assert "engine_speed_rpm" not in blind.stderr


def test_its_files_are_replaced_but_never_another_program_s(exported: Path) -> None:
    assert {path.name for path in exported.iterdir() if path.suffix} == set(FILES)
    assert all(is_own(exported / name) for name in FILES)
    assert cli.main(["export-c", "--out", str(exported)]) == 0
    own = exported / "o2_model.c"
    before = own.read_text()
    own.write_text("int my_own;\n")
    assert cli.main(["export-c", "--out", str(exported)]) == 2
    assert cli.main(["export-c", "--out", str(exported), "--force"]) == 0
    assert own.read_text() == before


@pytest.mark.parametrize("name", ["lambda_measured", "maf_kg_h", "no_such_signal"])
def test_a_signal_that_the_model_needs_cannot_be_left_out(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["export-c", "--out", str(tmp_path), "--without", name]) == 2
    assert f"--without {name}: wanted some of " in capsys.readouterr().err


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
def test_the_network_predicts_as_the_runtime_does(exported: Path, tmp_path: Path) -> None:
    # GIVEN random inputs in and beyond the trained ranges
    model = Model.load(shipped_model())
    channels = model.card.inputs
    low, high = (np.array([getattr(c, end) for c in channels]) for end in ("minimum", "maximum"))
    u = low + np.random.default_rng(1).uniform(-0.2, 1.2, (500, len(low))) * (high - low)
    # WHEN both predict step by step from an empty state
    # THEN they agree to some units in the last place
    wanted = [model.step(each) for each in u]
    assert c_monitor.predicted(exported, tmp_path, u) == pytest.approx(wanted, rel=2e-5)


@pytest.mark.parametrize("kind", ["Erf", "ReduceSum"])  # the sum over the batch
def test_a_graph_with_an_operator_of_its_own_is_refused_by_name(kind: str) -> None:
    from monitor.base.errors import ModelError

    graph = StepGraph([Node(kind, ["u", "axes"], ["lambda_hat"], {})], {"axes": np.array([0])})
    with pytest.raises(ModelError, match=rf"odd\.onnx: its graph has {kind} in a form"):
        network.step_code(graph, "lambda_hat", 1, 1, "odd.onnx")
