"""Completions, the unit and the forms are what the commands and guides are."""

import importlib.util
import re
import shutil
import subprocess
import tomllib

import pytest
import yaml

from tests.conftest import ROOT

GUIDE = ROOT / "docs" / "guides" / "service.md"


def test_completions_are_those_of_the_parsers() -> None:
    spec = importlib.util.spec_from_file_location("completions", ROOT / "share" / "completions.py")
    assert spec and spec.loader
    completions = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(completions)
    made = completions.files()
    assert len(made) == 4
    for path, text in made.items():
        stored = (ROOT / "share" / path).read_text()
        assert stored == text, f"share/{path} is old: python share/completions.py"


@pytest.mark.skipif(not shutil.which("bash"), reason="needs bash")
def test_bash_completes_commands_and_options() -> None:
    script = """
        source share/bash-completion/completions/o2mon
        COMP_WORDS=(o2mon rep); COMP_CWORD=1; _shtab_o2mon o2mon rep o2mon; echo ${COMPREPLY[@]}
        COMP_WORDS=(o2mon replay --me); COMP_CWORD=2; _shtab_o2mon o2mon --me replay
        echo ${COMPREPLY[@]}
    """
    command = ["bash", "-c", script]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["replay", "--memory"]


def test_the_guide_shows_the_unit_that_is_installed() -> None:
    unit = (ROOT / "share" / "systemd" / "o2mon.service").read_text()
    assert f"```ini\n{unit}```" in GUIDE.read_text()


def test_the_citation_has_the_version_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == project["version"]
    assert citation["license"] == project["license"]


def test_forms_for_issues_have_what_a_host_needs() -> None:
    forms = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("[!c]*.yml"))
    assert len(forms) == 3
    for path in forms:
        form = yaml.safe_load(path.read_text())
        assert {"name", "description", "body"} <= form.keys()
        ids = [field["id"] for field in form["body"]]
        assert len(ids) == len(set(ids))
        for field in form["body"]:
            assert field["type"] in ("input", "textarea", "dropdown")
            assert field["attributes"]["label"]


def test_the_container_runs_without_rights_and_copies_what_exists() -> None:
    text = (ROOT / "Dockerfile").read_text()
    assert re.search(r"^USER o2mon$", text, re.M)
    for name in re.findall(r"^!(\S+)", (ROOT / ".dockerignore").read_text(), re.M):
        assert (ROOT / name).exists(), name
