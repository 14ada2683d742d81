"""A folder or package with one of the project's names that stands in its way."""

from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from monitor.base import own_packages
from monitor.base.errors import UsageError


def test_a_plain_folder_of_the_name_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a folder of databases beside a user's script, and a project installed editable
    spec = ModuleSpec("dbc", None)
    spec.submodule_search_locations = [str(tmp_path / "dbc")]
    monkeypatch.setattr(own_packages, "find_spec", lambda name: spec)
    # WHEN the packages are checked, THEN the folder is named
    with pytest.raises(UsageError, match=f"another package named dbc.*{tmp_path / 'dbc'}"):
        own_packages.check(("dbc",))
