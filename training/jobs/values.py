"""Values of a run as files: numbers, texts, arrays and the project's dataclasses, without code.

A file is an ``.npz`` of plain arrays; the entry ``tree`` is JSON and tells what stands where. The
reader says which type it wants, and nothing else can come out of a file: the file names no class,
and arrays of objects are refused. So a folder that somebody else made cannot run code here.
"""

import dataclasses
import json
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, Protocol, Union, get_args, get_origin, get_type_hints

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.outputs import replaced

# Types with functions inside, and the function that returns such a thing by its name; a file holds
# the name, and the fields in which the thing differs from that one.
Named = Mapping[type, Callable[[str], Any]]
TREE: Final = "tree"
KINDS: Final = "biuf"  # of arrays, as numpy calls them
_PLAIN: Final[dict[Any, tuple[type, ...]]] = {
    bool: (bool, np.bool_),
    int: (int, np.integer),
    float: (float, int, np.floating, np.integer),
    str: (str,),
}


class ValuesError(RecordingError):
    """A file of a run does not hold a value of the wanted type."""


def save(path: Path, value: Any, kind: Any, named: Named | None = None) -> None:
    """Write a value of the type ``kind`` in one step, so that the file is never there in part.

    Raises TypeError if a part of the type has no form in a file.
    """
    store = Store()
    tree = form_of(kind, named or {}).pack(value, store)
    arrays = store.arrays | {TREE: np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8)}
    with replaced(path) as begun, begun.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def load(path: Path, kind: Any, named: Named | None = None) -> Any:
    """Return the value of the type ``kind`` that a file holds.

    Raises ValuesError if the file is damaged or holds something else, OSError if it cannot be read.
    """
    form = form_of(kind, named or {})
    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            return form.unpack(json.loads(arrays[TREE].tobytes()), Store(arrays))
        except Exception as error:  # zipfile and numpy raise a dozen kinds for damaged files
            raise ValuesError(f"{path}: is no stored {_name(kind)}: {error}") from error


@dataclass(slots=True)
class Store:
    """Content of a file beside the tree, and the objects that the tree refers to.

    An object that stands at several places is stored once, so that it is one object again.
    """

    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    places: dict[int, int] = field(default_factory=dict)  # of objects packed so far, by their id
    objects: list[Any] = field(default_factory=list)  # unpacked so far, in the same order


class Form(Protocol):
    """How values of one type stand in a JSON tree with arrays beside it."""

    def pack(self, value: Any, store: Store) -> Any:
        """Return the tree of a value and put its arrays aside; raises TypeError for others."""

    def unpack(self, tree: Any, store: Store) -> Any:
        """Return the value of a tree; raises one of several errors if the tree has no such form."""


def form_of(kind: Any, named: Named) -> Form:
    """Return the form of a type; raises TypeError if a part of it has none."""
    origin, members = get_origin(kind) or kind, get_args(kind)
    if kind in named:
        return _ByName(named[kind], _fields(kind, named, skip_unknown=True))
    if kind in _PLAIN or origin is Literal:
        return _Plain(kind)
    if origin is Path:
        return _Path()
    if origin is np.ndarray:
        return _Array()
    if origin in (Union, types.UnionType):
        inner = [each for each in members if each is not types.NoneType]
        forms = [(get_origin(each) or each, form_of(each, named)) for each in inner]
        return _OneOf(forms, len(inner) < len(members))
    return _compound(kind, named)


def _compound(kind: Any, named: Named) -> Form:
    origin, members = get_origin(kind) or kind, get_args(kind)
    if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
        return _Fields(kind, _fields(kind, named))
    if isinstance(origin, type) and members:
        if issubclass(origin, Mapping):
            return _Table(form_of(members[1], named))
        if issubclass(origin, Sequence):
            forms = [form_of(each, named) for each in members if each is not ...]
            endless = origin is not tuple or members[-1] is ...
            return _Items(list if origin is list else tuple, forms, endless)
    raise TypeError(f"{_name(kind)} has no form in a file")


def _fields(kind: Any, named: Named, *, skip_unknown: bool = False) -> dict[str, Form]:
    hints, forms = get_type_hints(kind), {}
    inner = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    for name in [each.name for each in inner if each.init] or kind._fields:
        try:
            forms[name] = form_of(hints[name], named)
        except TypeError:
            if not skip_unknown:
                raise
    return forms


def _name(kind: Any) -> str:
    return getattr(kind, "__name__", str(kind))


class _Plain:
    """A number, a text, a truth value, or one of several constants."""

    def __init__(self, kind: Any) -> None:
        self._kind, self._constants = kind, get_args(kind)
        self._types = _PLAIN.get(kind) or tuple(map(type, self._constants))

    def pack(self, value: Any, store: Store) -> Any:
        plain = value.item() if isinstance(value, np.generic) else value
        return self.unpack(plain, store)

    def unpack(self, tree: Any, store: Store) -> Any:
        is_right = isinstance(tree, self._types) and isinstance(tree, bool) == (self._kind is bool)
        if not is_right or (self._constants and tree not in self._constants):
            raise TypeError(f"{tree!r} is no {_name(self._kind)}")
        return tree


class _Path:
    def pack(self, value: Any, store: Store) -> Any:
        return str(value)

    def unpack(self, tree: Any, store: Store) -> Any:
        return Path(tree)


class _Array:
    """An array of numbers: the tree holds its name."""

    def pack(self, value: Any, store: Store) -> Any:
        name, array = f"a{len(store.arrays)}", np.asarray(value)
        if array.dtype.kind not in KINDS:
            raise TypeError(f"an array of {array.dtype} has no form in a file")
        store.arrays[name] = array
        return name

    def unpack(self, tree: Any, store: Store) -> Any:
        array = store.arrays[tree]
        if tree == TREE or array.dtype.kind not in KINDS:
            raise ValueError(f"{tree} is no array of numbers")
        return array


class _OneOf:
    """A value of one of several types, or None."""

    def __init__(self, forms: Sequence[tuple[Any, Form]], has_none: bool) -> None:
        self._forms, self._has_none = forms, has_none

    def pack(self, value: Any, store: Store) -> Any:
        if value is None and self._has_none:
            return None
        if len(self._forms) == 1:
            return self._forms[0][1].pack(value, store)
        for place, (kind, form) in enumerate(self._forms):
            if isinstance(value, kind):
                return [place, form.pack(value, store)]
        raise TypeError(f"{value!r} is none of the types")

    def unpack(self, tree: Any, store: Store) -> Any:
        if tree is None and self._has_none:
            return None
        if len(self._forms) == 1:
            return self._forms[0][1].unpack(tree, store)
        place, packed = tree
        return self._forms[place][1].unpack(packed, store)


class _Table:
    """A mapping with texts as keys."""

    def __init__(self, form: Form) -> None:
        self._form = form

    def pack(self, value: Any, store: Store) -> Any:
        return {name: self._form.pack(each, store) for name, each in value.items()}

    def unpack(self, tree: Any, store: Store) -> Any:
        return {name: self._form.unpack(each, store) for name, each in tree.items()}


class _Items:
    """A sequence: of any length with items of one type, or of a type for each place."""

    def __init__(self, make: type, forms: Sequence[Form], endless: bool) -> None:
        self._make, self._forms, self._endless = make, forms, endless

    def _of(self, n: int) -> Sequence[Form]:
        return [self._forms[0]] * n if self._endless else self._forms

    def pack(self, value: Any, store: Store) -> Any:
        pairs = zip(value, self._of(len(value)), strict=True)
        return [form.pack(each, store) for each, form in pairs]

    def unpack(self, tree: Any, store: Store) -> Any:
        if not isinstance(tree, list):
            raise TypeError(f"{tree!r} is no sequence")
        pairs = zip(tree, self._of(len(tree)), strict=True)
        return self._make(form.unpack(each, store) for each, form in pairs)


class _Fields:
    """A dataclass or a named tuple: its fields, or the place of an object that came before."""

    def __init__(self, kind: Any, forms: Mapping[str, Form]) -> None:
        self._kind, self._forms = kind, forms

    def pack(self, value: Any, store: Store) -> Any:
        if id(value) in store.places:
            return store.places[id(value)]
        if not isinstance(value, self._kind):
            raise TypeError(f"{value!r} is no {_name(self._kind)}")
        tree = {name: form.pack(getattr(value, name), store) for name, form in self._forms.items()}
        store.places[id(value)] = len(store.places)
        return tree

    def unpack(self, tree: Any, store: Store) -> Any:
        if isinstance(tree, int):
            found = store.objects[tree]
            if not isinstance(found, self._kind):
                raise TypeError(f"{found!r} is no {_name(self._kind)}")
            return found
        made = self._kind(**{n: form.unpack(tree[n], store) for n, form in self._forms.items()})
        store.objects.append(made)
        return made


class _ByName:
    """A thing with functions inside: its name, and the fields that differ from the named thing."""

    def __init__(self, find: Callable[[str], Any], forms: Mapping[str, Form]) -> None:
        self._find, self._forms = find, forms

    def pack(self, value: Any, store: Store) -> Any:
        known = self._find(value.name)
        changed = [n for n in self._forms if getattr(value, n) != getattr(known, n)]
        return {
            "name": value.name,
            "changed": {n: self._forms[n].pack(getattr(value, n), store) for n in changed},
        }

    def unpack(self, tree: Any, store: Store) -> Any:
        changed = {n: self._forms[n].unpack(each, store) for n, each in tree["changed"].items()}
        return dataclasses.replace(self._find(tree["name"]), **changed)
