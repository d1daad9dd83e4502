"""Records as plain data and back: what is kept of the results of items, as JSON.

A record is written by the names of its fields and read by their types, so that reading makes nothing but the record
that was asked for. Paths are not kept but referred to: by their place among those that the item has anyway.
"""

import dataclasses
import types
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import numpy as np


def as_plain(value: Any, paths: Sequence[Path] = ()) -> Any:
    """Return a value as plain data: of records, tuples, mappings, arrays, numbers and texts, and some paths.

    Raises TypeError for a value of another kind, or another path: that is a bug.
    """
    if dataclasses.is_dataclass(value):
        kept = [field.name for field in dataclasses.fields(value) if field.init]
        return {name: as_plain(getattr(value, name), paths) for name in kept}
    if isinstance(value, Mapping):
        return {str(key): as_plain(each, paths) for key, each in value.items()}
    if isinstance(value, (tuple, list)):
        return [as_plain(each, paths) for each in value]
    return _single(value, paths)


def _single(value: Any, paths: Sequence[Path]) -> Any:
    if isinstance(value, np.ndarray):
        return {"type": value.dtype.str, "shape": list(value.shape), "values": value.ravel().tolist()}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path) and value in paths:
        return list(paths).index(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"{value!r} is not kept as plain data")


def of_plain(kind: Any, data: Any, paths: Sequence[Path] = ()) -> Any:
    """Return the value of a type from its plain data; raises KeyError, TypeError or ValueError if it is another's."""
    if data is None or kind is Any:
        return data
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Annotated, Union, types.UnionType):
        return _one_of(arguments[:1] if origin is Annotated else arguments, data, paths)
    if origin is np.ndarray:
        return np.array(data["values"], dtype=data["type"]).reshape(data["shape"])
    if isinstance(data, (dict, list)):
        return _several(arguments, data, paths) if origin else _record(kind, data, paths)
    return paths[data] if kind is Path else kind(data)


def _one_of(kinds: Sequence[Any], data: Any, paths: Sequence[Path]) -> Any:
    """Return a value of a union: of the one type that is not None, or as it is where plain types are meant."""
    some = [kind for kind in kinds if kind is not types.NoneType]
    if len(some) == 1:
        return of_plain(some[0], data, paths)
    return tuple(data) if isinstance(data, list) else data


def _several(kinds: Sequence[Any], data: Any, paths: Sequence[Path]) -> Any:
    """Return a mapping, whose keys are texts, or a tuple."""
    if isinstance(data, dict):
        return {key: of_plain(kinds[1], each, paths) for key, each in data.items()}
    each = kinds if len(kinds) == len(data) and ... not in kinds else [kinds[0]] * len(data)
    return tuple(of_plain(kind, item, paths) for kind, item in zip(each, data, strict=True))


def _record(kind: Any, data: Any, paths: Sequence[Path]) -> Any:
    """Return a record from its fields by name, a named tuple from those in their order."""
    hints = _hints(kind)
    if isinstance(data, list):
        return kind(*(of_plain(hints[name], each, paths) for name, each in zip(kind._fields, data, strict=True)))
    return kind(**{name: of_plain(hints[name], each, paths) for name, each in data.items()})


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)
