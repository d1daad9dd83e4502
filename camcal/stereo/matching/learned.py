"""Disparity by a neural network in a file of the user's own: ONNX, run by ONNX Runtime if installed, else by OpenCV.

The contract with the model: two inputs, left and right in this order, 1 × 3 × H × W or 1 × 1 × H × W float32; one
output, 1 × 1 × H × W, 1 × H × W or H × W, the disparity of the left image in pixels, positive. H and W are those of the
images rounded up to multiples of 32, or those of the model if it has fixed ones; the edges are repeated at the right
and at the bottom to fill them. What goes in and comes out is read from the file without a library.
Source: the protocol buffers of ONNX (onnx.proto: ModelProto, GraphProto, ValueInfoProto) and their wire format.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput
from camcal.files import read_bytes
from camcal.raw.mosaic import full_scale

FLOAT32 = 1  # TensorProto.DataType

_GRAPH = 7  # of ModelProto
_INITIALIZER, _INPUT, _OUTPUT = 5, 11, 12  # of GraphProto
_TENSOR_NAME = 8  # of TensorProto
_VARINT, _EIGHT_BYTES, _PIECE, _FOUR_BYTES = 0, 1, 2, 5  # kinds of fields on the wire

_Value = int | memoryview
_MULTIPLE = 32  # networks halve their images up to five times
_RUNTIME = "onnxruntime"
_RUNTIME_ERRORS = ("Fail", "InvalidArgument", "InvalidGraph", "InvalidProtobuf", "NotImplemented", "RuntimeException")


@dataclass(frozen=True)
class Tensor:
    """An input or output: its name, ONNX's number of its element type, its shape, None for what may vary."""

    name: str
    element: int
    shape: tuple[int | None, ...]

    def __str__(self) -> str:
        return f"{self.name} {' × '.join('?' if size is None else str(size) for size in self.shape)}"


def read_graph(path: Path) -> tuple[list[Tensor], list[Tensor]]:
    """Return the inputs and outputs of a model; weights, which old models list as inputs, are left out.

    Raises FileError if the file is missing, empty or not an ONNX model.
    """
    content = memoryview(read_bytes(path))
    try:
        parts = list(_fields(_piece(content, _GRAPH)))
        weights = {_text(_piece(_message(value), _TENSOR_NAME)) for number, value in parts if number == _INITIALIZER}
        inputs = [_tensor(_message(value)) for number, value in parts if number == _INPUT]
        outputs = [_tensor(_message(value)) for number, value in parts if number == _OUTPUT]
    except (IndexError, ValueError) as error:
        raise FileError("not an ONNX model, or truncated", where=str(path)) from error
    return [tensor for tensor in inputs if tensor.name not in weights], outputs


def _tensor(info: memoryview) -> Tensor:
    """Return what a ValueInfoProto says: name = 1, type = 2; in it tensor_type = 1: elem_type = 1, shape = 2."""
    kind = _piece(_piece(info, 2), 1)
    fields = dict(_fields(kind))
    element = fields.get(1, 0)
    shape = _fields(_message(fields.get(2, memoryview(b""))))
    sizes = (dict(_fields(_message(value))).get(1) for number, value in shape if number == 1)
    return Tensor(
        _text(_piece(info, 1)),
        element if isinstance(element, int) else 0,
        tuple(size if isinstance(size, int) and size > 0 else None for size in sizes),
    )


def _piece(message: memoryview, number: int) -> memoryview:
    """Return the last field of a number that is a piece of bytes; raises ValueError if there is none."""
    return _message(dict(_fields(message)).get(number, 0))


def _message(value: _Value) -> memoryview:
    if isinstance(value, int):
        raise ValueError("a piece of bytes was expected")  # noqa: TRY004 (damage of the file, not a wrong argument)
    return value


def _text(piece: memoryview) -> str:
    return str(piece, "utf-8")


def _fields(message: memoryview) -> Iterator[tuple[int, _Value]]:
    """Yield the number and the value of each field; raises IndexError or ValueError where the bytes make no sense."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == _VARINT:
            value, at = _varint(message, at)
            yield number, value
            continue
        if kind == _PIECE:
            size, at = _varint(message, at)
        elif kind in {_EIGHT_BYTES, _FOUR_BYTES}:
            size = 8 if kind == _EIGHT_BYTES else 4
        else:
            raise ValueError(f"field of kind {kind}")
        if at + size > len(message):
            raise ValueError(f"{size} bytes at {at} of {len(message)}")
        yield number, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Return the number that begins at a place, seven bits a byte, and the place behind it."""
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 127) << shift
        at += 1
        if byte < 128:
            return value, at
        shift += 7
        if shift > 63:
            raise ValueError("a number of more than 64 bits")


def learned_disparity(
    left: Array, right: Array, model: Path, white: float = 255.0, *, blue_first: bool = False
) -> Array:
    """Return the disparity (H, W), float32 pixels, of a rectified pair by the network of an ONNX file.

    left, right: (H, W) gray, (H, W, 3) blue, green, red or (H, W, 4) with alpha; uint8, uint16 or float32 0 … 1.
    white: what the network takes for white, 1 or 255. blue_first: whether it takes blue before red.
    Raises FileError for a file that is missing or not an ONNX model, InvalidInput for images of two sizes and for a
    model that breaks the contract above or cannot be run.
    """
    if left.shape[:2] != right.shape[:2]:
        raise InvalidInput(f"the left image is {_size(left.shape)}, the right one {_size(right.shape)}")
    inputs, outputs = read_graph(model)
    _require_pair(inputs, outputs, model)
    shape = _padded_shape(left.shape, inputs[0], model)
    feeds = {
        tensor.name: _blob(image, shape, tensor.shape[1] == 1, white, blue_first)
        for tensor, image in zip(inputs, (left, right), strict=True)
    }
    run = _by_onnxruntime if find_spec(_RUNTIME) else _by_opencv
    return _disparity(run(model, feeds), shape, model)[: left.shape[0], : left.shape[1]]


def _require_pair(inputs: Sequence[Tensor], outputs: Sequence[Tensor], model: Path) -> None:
    """Raise InvalidInput unless two images go in, of the same shape, and one map comes out."""
    if len(inputs) != 2 or len(outputs) != 1:
        found = f"{', '.join(map(str, inputs)) or 'nothing'} to {', '.join(map(str, outputs)) or 'nothing'}"
        raise InvalidInput(f"the model must turn two images into one disparity map, found {found}", where=str(model))
    for tensor in inputs:
        batch, channels = (*tensor.shape, 0, 0)[:2]
        if len(tensor.shape) != 4 or batch not in {1, None} or channels not in {1, 3, None}:
            raise InvalidInput(f"an input must be 1 × 3 × H × W or 1 × 1 × H × W, found {tensor}", where=str(model))
        if tensor.element != FLOAT32:
            raise InvalidInput(f"the input {tensor.name} must be float32", where=str(model))
    if inputs[0].shape[2:] != inputs[1].shape[2:]:
        raise InvalidInput(f"the inputs have two sizes, {inputs[0]} and {inputs[1]}", where=str(model))


def _padded_shape(shape: tuple[int, ...], tensor: Tensor, model: Path) -> tuple[int, int]:
    """Return rows and columns for the network; raises InvalidInput if it has fixed ones that are too few."""
    needed = [-(-size // _MULTIPLE) * _MULTIPLE for size in shape[:2]]
    rows, columns = (size if fixed is None else fixed for size, fixed in zip(needed, tensor.shape[2:], strict=True))
    if rows < shape[0] or columns < shape[1]:
        raise InvalidInput(
            f"the model takes images of {columns} × {rows} pixels, these are {_size(shape)}; "
            "reduce them, or export the model for their size",
            where=str(model),
        )
    return rows, columns


def _blob(image: Array, shape: tuple[int, int], gray: bool, white: float, blue_first: bool) -> Array:
    """Return an image as (1, C, rows, columns) float32, its edges repeated to the right and below."""
    light: Array = image.astype(np.float32) * np.float32(white / full_scale(image.dtype))
    if light.ndim == 3 and gray:
        light = np.asarray(cv2.cvtColor(np.ascontiguousarray(light[..., :3]), cv2.COLOR_BGR2GRAY))
    if light.ndim == 2:
        light = np.repeat(light[..., None], 1 if gray else 3, axis=2)
    ordered = light[..., :3] if blue_first else light[..., 2::-1]
    below, beside = shape[0] - image.shape[0], shape[1] - image.shape[1]
    padded = np.pad(ordered, ((0, below), (0, beside), (0, 0)), mode="edge")
    return np.ascontiguousarray(padded.transpose(2, 0, 1)[None])


def _by_onnxruntime(model: Path, feeds: dict[str, Array]) -> Array:
    runtime: Any = import_module(_RUNTIME)
    state = import_module(f"{_RUNTIME}.capi.onnxruntime_pybind11_state")
    try:
        session = runtime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
        return np.asarray(session.run(None, feeds)[0])
    except tuple(getattr(state, name) for name in _RUNTIME_ERRORS) as error:
        raise InvalidInput(f"ONNX Runtime cannot run the model: {_first_line(error)}", where=str(model)) from error


def _by_opencv(model: Path, feeds: dict[str, Array]) -> Array:
    try:
        with _without_messages():
            network = cv2.dnn.readNetFromONNX(str(model))
            for name, blob in feeds.items():
                network.setInput(blob, name)
            return np.asarray(network.forward())
    except cv2.error as error:
        advice = "ONNX Runtime may: pip install 'camcal[onnx]'"
        raise InvalidInput(f"OpenCV cannot run the model ({_first_line(error)}); {advice}", where=str(model)) from error


@contextmanager
def _without_messages() -> Iterator[None]:
    """Keep OpenCV from printing on its own what it raises anyway."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _disparity(output: Array, shape: tuple[int, int], model: Path) -> Array:
    """Return the output of a network (rows, columns), float32; raises InvalidInput if it is no disparity map."""
    if output.shape[-2:] != shape or output.size != shape[0] * shape[1]:
        found = " × ".join(map(str, output.shape))
        raise InvalidInput(f"the output must be 1 × 1 × {shape[0]} × {shape[1]}, found {found}", where=str(model))
    values = output.reshape(shape).astype(np.float32)
    if np.all(values < 0):
        raise InvalidInput("all disparities of the model are negative; left minus right is needed", where=str(model))
    return values


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0]


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} × {shape[0]}"
