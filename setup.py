"""Puts a bill of materials into the wheel: ``.dist-info/sboms/o2-monitor.cdx.json`` (PEP 770).

Wheel and archive of the sources depend on no owner or mask of the builder; with
``SOURCE_DATE_EPOCH`` the same tree gives the same bytes. All else about the package stands in
pyproject.toml. The bill is CycloneDX 1.6: the package, the packages that it needs with the ranges
that it accepts, and the works of others that it contains.
"""

import gzip
import hashlib
import json
import os
import re
import tarfile
import time
import tomllib
from io import BytesIO
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.sdist import sdist

ROOT = Path(__file__).parent
NAME = "o2-monitor.cdx.json"
# Works of others in the wheel; see NOTICE.
CONTAINED = (
    {
        "type": "library",
        "name": "uPlot",
        "version": "1.6.32",
        "purl": "pkg:npm/uplot@1.6.32",
        "licenses": [{"license": {"id": "MIT"}}],
        "files": ["monitor/report/static/uplot/uPlot.iife.min.js"],
    },
    {
        "type": "data",
        "name": "FASTSim drive cycles",
        "licenses": [{"license": {"id": "Apache-2.0"}}],
        "files": sorted(
            path.relative_to(ROOT).as_posix() for path in ROOT.glob("training/dyno/cycles/*.csv")
        ),
    },
)


def bill_of_materials() -> dict:
    """Return the bill as a JSON tree; the same tree of files gives the same bill."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    own = f"pkg:pypi/{project['name']}@{project['version']}"
    extras = project["optional-dependencies"]
    needed = dict.fromkeys(project["dependencies"], "")
    for extra, names in extras.items():
        for wanted in names:
            if extra not in ("dev", "docs"):
                needed.setdefault(wanted, extra)
    components = [_package(wanted, extra) for wanted, extra in needed.items()]
    components += [_contained(work) for work in CONTAINED]
    required = [each["bom-ref"] for each in components if each.get("scope") == "required"]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": own,
                "name": project["name"],
                "version": project["version"],
                "purl": own,
                "licenses": [{"license": {"id": project["license"]}}],
            }
        },
        "components": components,
        "dependencies": [{"ref": own, "dependsOn": sorted(required)}],
    }


def _package(wanted: str, extra: str) -> dict:
    """Return the component of a requirement; ``extra`` is "" for one that is always needed."""
    name, accepted = re.fullmatch(r"([A-Za-z0-9_.-]+)(?:\[[^]]*\])?(.*)", wanted).groups()
    properties = [{"name": "o2-monitor:accepted", "value": accepted.strip()}]
    properties += [{"name": "o2-monitor:extra", "value": extra}] if extra else []
    return {
        "type": "library",
        "bom-ref": f"pkg:pypi/{name}",
        "name": name,
        "purl": f"pkg:pypi/{name}",
        "scope": "optional" if extra else "required",
        "properties": properties,
    }


def _contained(work: dict) -> dict:
    """Return the component of a work in the wheel, with the sha256 of its files."""
    digest = hashlib.sha256()
    for name in work["files"]:
        digest.update((ROOT / name).read_bytes())
    rest = {key: value for key, value in work.items() if key != "files"}
    properties = [{"name": "o2-monitor:file", "value": name} for name in work["files"]]
    hashes = [{"alg": "SHA-256", "content": digest.hexdigest()}]  # of the files one after another
    return rest | {"bom-ref": work["name"], "hashes": hashes, "properties": properties}


class Wheel(bdist_wheel):
    """A wheel with the bill in its metadata."""

    def write_wheelfile(self, wheelfile_base: str, *args: object, **keywords: object) -> None:
        """Write the wheel's own metadata, and the bill beside it."""
        super().write_wheelfile(wheelfile_base, *args, **keywords)
        folder = Path(wheelfile_base) / "sboms"
        folder.mkdir(exist_ok=True)
        (folder / NAME).write_text(json.dumps(bill_of_materials(), indent=1) + "\n")
        for path in folder.parents[1].rglob("*"):  # a mask of the builder is none of the wheel
            if path.is_file():
                path.chmod(_mode(path))


def _mode(path: Path) -> int:
    """Return the rights of a file or folder in an archive."""
    return 0o755 if path.is_dir() or path.stat().st_mode & 0o100 else 0o644


class Sources(sdist):
    """An archive whose bytes depend on names and contents of the files only."""

    def make_archive(self, base_name: str, format: str, *args: object, **keywords: object) -> str:
        """Write the archive in the order of its names."""
        if format != "gztar":
            return super().make_archive(base_name, format, *args, **keywords)
        epoch_s = int(os.environ.get("SOURCE_DATE_EPOCH", time.time()))
        place = Path(f"{base_name}.tar.gz")
        folder = Path(self.distribution.get_fullname())
        with (
            place.open("wb") as file,
            gzip.GzipFile("", "wb", mtime=epoch_s, fileobj=file) as packed,
            tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as archive,
        ):
            for path in sorted(folder.rglob("*")):
                member = archive.gettarinfo(str(path), path.as_posix())
                member.mtime, member.uid, member.gid = epoch_s, 0, 0
                member.uname = member.gname = ""
                member.mode = _mode(path)
                content = path.read_bytes() if path.is_file() else b""
                archive.addfile(member, BytesIO(content))
        return str(place)


if __name__ == "__main__":
    setup(cmdclass={"bdist_wheel": Wheel, "sdist": Sources})
