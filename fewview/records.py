"""Frozen dataclasses as bytes and back, exact to the bit: one .npz of arrays and a JSON header.

Reading follows the type hints of the class that is asked for and unpickles nothing, so a file from
elsewhere can make nothing but what its reader expects. Fields may be dataclasses, tuples, mappings,
enums, NumPy arrays and scalars of any dtype, numbers, texts and None.
"""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import io
import json
import types
import typing
from collections.abc import Mapping
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

HEADER, ENTRY = "arr_0", "arr_{}"
"""Names that NumPy gives the entries of an archive: the header comes first."""
ARRAY = "array"
Record = TypeVar("Record")


class RecordError(ValueError):
    """Bytes that are not a record of the class asked for."""


def encode(record: object) -> bytes:
    """A record as the bytes of an uncompressed .npz.

    Raises:
        TypeError: it holds something that is none of the types above.
    """
    arrays: list[NDArray[Any]] = []
    header = np.frombuffer(json.dumps(_flattened(record, arrays)).encode(), np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, header, *arrays)
    return buffer.getvalue()


def decode(data: bytes, kind: type[Record]) -> Record:
    """The record of a class that `encode` made.

    Raises:
        RecordError: the bytes are damaged or of something else.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            header = json.loads(archive[HEADER].tobytes())
            return typing.cast(Record, _restored(header, kind, archive))
    except Exception as error:  # a damaged archive fails in a dozen ways
        raise RecordError(f"no {kind.__name__} can be read ({error})") from error


def digest(value: object) -> str:
    """A fingerprint (32 hexadecimal digits) of a value of the types above: equal for equal bits."""
    arrays: list[NDArray[Any]] = []
    state = hashlib.sha256(json.dumps(_flattened(value, arrays)).encode())
    for array in arrays:
        state.update(f"{array.dtype.str} {array.shape}".encode())
        state.update(array.tobytes())
    return state.hexdigest()[:32]


def _flattened(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """What JSON can hold of a value; arrays and NumPy's scalars are appended to ``arrays``."""
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.hasobject:
            raise TypeError("an array of Python objects cannot be recorded")
        arrays.append(np.asarray(value))
        return {ARRAY: ENTRY.format(len(arrays))}
    if dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        return {f.name: _flattened(getattr(value, f.name), arrays) for f in fields}
    if isinstance(value, Mapping):
        return [[_flattened(part, arrays) for part in item] for item in value.items()]
    if isinstance(value, tuple):
        return [_flattened(part, arrays) for part in value]
    if isinstance(value, enum.Enum):
        return value.value
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"a {type(value).__name__} cannot be recorded")


def _restored(node: Any, hint: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """The value of a type that was flattened to a node."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        (some,) = (option for option in inner if option is not types.NoneType)
        return None if node is None else _restored(node, some, arrays)
    if origin is np.ndarray:
        return arrays[node[ARRAY]]
    if origin is tuple:
        hints = inner[:1] * len(node) if inner[1:] == (Ellipsis,) else inner
        return tuple(_restored(n, h, arrays) for n, h in zip(node, hints, strict=True))
    if origin is Mapping:
        key, value = inner
        return {_restored(k, key, arrays): _restored(v, value, arrays) for k, v in node}
    if dataclasses.is_dataclass(hint):
        make: Any = hint
        fields = _fields(make).items()
        return make(**{name: _restored(node[name], field, arrays) for name, field in fields})
    if isinstance(node, dict):
        return arrays[node[ARRAY]][()]
    if issubclass(hint, enum.Enum):
        return hint(node)
    if not isinstance(node, int | float if hint is float else hint):
        raise TypeError(f"{node!r} where {hint.__name__} is expected")
    return node


@cache
def _fields(kind: type) -> Mapping[str, Any]:
    """The types of a dataclass's fields by their names."""
    return typing.get_type_hints(kind)
