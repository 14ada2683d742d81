"""Values of a run as files: numbers, texts, arrays and our own dataclasses, without code.

A file is an ``.npz`` of plain arrays; its entry ``tree`` is JSON and tells what stands where. It
names no code but dataclasses and named tuples of this repository, whose fields it fills, and arrays
of objects are refused. So a folder that somebody else made cannot run code here.
"""

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import UnionType
from typing import Any, Final, get_origin

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.files.outputs import replaced

# Types with functions inside, and the function that returns such a thing by its name; a file holds
# the name, and the fields in which the thing differs from that one.
Named = Mapping[type, Callable[[str], Any]]
TREE: Final = "tree"
KINDS: Final = "biuf"  # of arrays, as numpy calls them
OURS: Final = ("monitor", "training", "benchmarks", "tests")


class ValuesError(RecordingError):
    """A file of a run does not hold a value of the wanted type."""


def save(path: Path, value: Any, named: Named | None = None) -> None:
    """Write a value in one step, so that the file is never there in part.

    Raises TypeError if a part of the value has no form in a file.
    """
    store = _Store(named or {})
    text = json.dumps(store.pack(value)).encode()
    arrays = store.arrays | {TREE: np.frombuffer(text, dtype=np.uint8)}
    with replaced(path) as begun, begun.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def load(path: Path, kind: Any, named: Named | None = None) -> Any:
    """Return the value that a file holds, which is of the type ``kind`` or one of a union.

    Raises ValuesError if the file is damaged or holds something else, OSError if it cannot be read.
    """
    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            store = _Store(named or {}, arrays)
            found = store.unpack(json.loads(arrays[TREE].tobytes()))
            is_plain = get_origin(kind) in (None, UnionType)
            if not isinstance(found, kind if is_plain else get_origin(kind)):
                raise TypeError(f"it is a {type(found).__name__}")
        except Exception as error:  # zipfile and numpy raise a dozen kinds for damaged files
            name = getattr(kind, "__name__", kind)
            raise ValuesError(f"{path}: is no stored {name}: {error}") from error
        return found


@dataclass(slots=True)
class _Store:
    """Content of a file beside the tree; an object that stands at several places is one again."""

    named: Named
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    places: dict[int, int] = field(default_factory=dict)  # of objects packed so far, by their id
    objects: dict[int, Any] = field(default_factory=dict)  # unpacked so far, by their place

    def pack(self, value: Any) -> Any:
        """Return the tree of a value and put its arrays aside."""
        value = value.item() if isinstance(value, np.generic) else value
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
            return [self.pack(each) for each in value]
        if isinstance(value, Path):
            return {"path": str(value)}
        if isinstance(value, np.ndarray) and value.dtype.kind in KINDS:
            self.arrays[name := f"a{len(self.arrays)}"] = value
            return {"array": name}
        if isinstance(value, Mapping):
            return {"map": {name: self.pack(each) for name, each in value.items()}}
        return self._pack_object(value, type(value))

    def _pack_object(self, value: Any, kind: type) -> dict[str, Any]:
        tree: dict[str, Any] = {"is": f"{kind.__module__}.{kind.__name__}"}
        parts = {name: getattr(value, name) for name in _fields(kind)}
        if kind in self.named:
            known = self.named[kind](value.name)
            parts = {n: x for n, x in parts.items() if not callable(x) and x != getattr(known, n)}
            tree["name"] = value.name
        elif id(value) in self.places:
            return {"at": self.places[id(value)]}
        packed = {name: self.pack(each) for name, each in parts.items()}
        self.places[id(value)] = len(self.places)
        return tree | {"at": self.places[id(value)], "of": packed}

    def unpack(self, tree: Any) -> Any:
        """Return the value of a tree; raises one of several errors if the tree has no such form."""
        if isinstance(tree, list):
            return tuple(self.unpack(each) for each in tree)
        if not isinstance(tree, dict):
            return tree
        if "is" in tree:
            kind = _kind(tree["is"])
            parts = {name: self.unpack(each) for name, each in tree["of"].items()}
            if kind in self.named:
                return dataclasses.replace(self.named[kind](tree["name"]), **parts)
            self.objects[tree["at"]] = kind(**parts)
        if "at" in tree:
            return self.objects[tree["at"]]
        if "map" in tree:
            return {name: self.unpack(each) for name, each in tree["map"].items()}
        return Path(tree["path"]) if "path" in tree else self.arrays[tree["array"]]


def _fields(kind: Any) -> tuple[str, ...]:
    """Return the fields of a dataclass or named tuple; raises TypeError for another type."""
    if dataclasses.is_dataclass(kind):
        return tuple(each.name for each in dataclasses.fields(kind) if each.init)
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return tuple(kind._fields)
    raise TypeError(f"{kind.__name__} has no form in a file")


def _kind(name: str) -> Any:
    """Return a dataclass or named tuple of ours by its name with its module."""
    module, _, own = name.rpartition(".")
    if module.split(".")[0] not in OURS:
        raise TypeError(f"{name} is none of ours")
    found = getattr(import_module(module), own)
    _fields(found)
    return found
