"""The exported C has no finding of MISRA C:2012 beyond the advisory rules below."""

import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import pytest

from monitor import cli

# advisory rules that are not followed, and why
ADVISORY: Final[Mapping[str, str]] = {
    "2.4": "an enum's tag would name a type that no variable has: fields are of one byte",
    "2.5": "o2_tables.h names all signals, codes and settings, used or not",
    "8.9": "tables stand in one file, so that flash can be placed as one section",
    "8.11": "the names' tables end with what the model has",
    "15.5": "a return where nothing is left to do is read more easily than nested branches",
}


@pytest.mark.skipif(not shutil.which("cppcheck"), reason="needs cppcheck")
def test_no_mandatory_and_no_required_rule_is_broken(tmp_path: Path) -> None:
    assert cli.main(["export-c", "--out", str(tmp_path)]) == 0
    files = sorted(path.name for path in tmp_path.glob("o2_*.c"))
    call = ["cppcheck", "--std=c99", "--addon=misra", "--quiet", "--suppress=missingIncludeSystem"]
    call += ["--enable=style,warning,performance,portability", "--template={id} {file}:{line}"]
    done = subprocess.run([*call, *files], cwd=tmp_path, capture_output=True, text=True, check=True)
    found = re.findall(r"^(\S+) (\S+:\d+)$", done.stderr, re.MULTILINE)
    assert found  # else the addon has not run
    allowed = {f"misra-c2012-{rule}" for rule in ADVISORY}
    assert [each for each in found if each[0] not in allowed] == []
