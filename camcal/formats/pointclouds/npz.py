"""NPZ: one NumPy array per kind of number, with unit, frame and notes beside them.

points (N, 3) float32; colours (N, 3) uint8; intensity (N,), normals (N, 3) and sigma (N,) float32, where there are any.
The vertices of an image have its rows and columns in the place of N.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np

from camcal.arrays import Array
from camcal.errors import CamcalError, FileError
from camcal.formats.documents import parse_json
from camcal.formats.pointclouds.record import PointCloudFile, blocks_of, cloud_of
from camcal.images.npy import arrays_of
from camcal.stereo.points.frames import COLOUR, INTENSITY, METRES, NORMAL, POSITION, SIGMA, VertexStream

_FIELDS: dict[str, tuple[str, ...]] = {
    "points": POSITION,
    "colours": COLOUR,
    "intensity": (INTENSITY,),
    "normals": NORMAL,
    "sigma": (SIGMA,),
}


def write(file: BinaryIO, stream: VertexStream) -> None:
    """Write a cloud, whose arrays are filled block by block."""
    arrays = {
        name: np.empty((stream.count, len(fields)), stream.type[fields[0]])
        for name, fields in _FIELDS.items()
        if fields[0] in (stream.type.names or ())
    }
    at = 0
    for block in blocks_of(stream):
        for name, array in arrays.items():
            for column, field in enumerate(_FIELDS[name]):
                array[at : at + len(block), column] = block[field]
        at += len(block)
    rows = (stream.count,) if stream.grid is None else stream.grid[::-1]
    shaped: dict[str, Any] = {
        name: array.reshape(*rows, *array.shape[1:][array.shape[1] == 1 :]) for name, array in arrays.items()
    }
    words = {"unit": stream.unit, "frame": stream.frame, "notes": json.dumps(stream.notes, ensure_ascii=False)}
    np.savez(file, **(shaped | words))


def read(content: bytes) -> PointCloudFile:
    """Return the vertices of arrays named as above; only points need be there.

    Raises FileError if the file is no NPZ, or an array has another shape than the points have.
    """
    arrays = _arrays(content)
    if "points" not in arrays:
        raise FileError(f"has no array points; its arrays are {', '.join(arrays) or 'none'}")
    shape = arrays["points"].shape[:-1]
    if len(shape) not in {1, 2}:
        raise FileError(f"points have the shape {arrays['points'].shape}, expected (N, 3) or (rows, columns, 3)")
    columns: dict[str, Array] = {}
    for name in _FIELDS.keys() & arrays.keys():
        columns |= _columns(name, arrays[name], shape)
    words = {"unit": str(arrays.get("unit", METRES)), "frame": str(arrays.get("frame", ""))}
    cloud = cloud_of(columns, **words, notes=_notes(arrays))
    return replace(cloud, grid=(shape[1], shape[0])) if len(shape) == 2 else cloud


def _arrays(content: bytes) -> Mapping[str, Any]:
    try:
        return arrays_of(content)
    except ValueError as error:
        raise FileError("not a readable NPZ file (np.savez writes one)") from error


def _columns(name: str, array: Array, shape: tuple[int, ...]) -> dict[str, Array]:
    fields = _FIELDS[name]
    expected = shape if len(fields) == 1 else (*shape, len(fields))
    if array.shape != expected or array.dtype.kind not in "uif":
        raise FileError(f"{name} has {array.dtype} of shape {array.shape}, expected numbers of shape {expected}")
    flat = array.reshape(-1, len(fields))
    return {field: flat[:, column] for column, field in enumerate(fields)}


def _notes(arrays: Mapping[str, Any]) -> dict[str, str]:
    try:
        found = parse_json(str(arrays.get("notes", "{}")))
    except CamcalError:
        return {}
    return {str(key): str(value) for key, value in found.items()} if isinstance(found, dict) else {}
