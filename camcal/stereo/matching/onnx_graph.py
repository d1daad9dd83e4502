"""What goes into an ONNX model and what comes out of it, read from the file without a library.

Source: the protocol buffers of ONNX (onnx.proto: ModelProto, GraphProto, ValueInfoProto) and their wire format.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from camcal.errors import FileError
from camcal.files import read_bytes

FLOAT32 = 1  # TensorProto.DataType

_GRAPH = 7  # of ModelProto
_INITIALIZER, _INPUT, _OUTPUT = 5, 11, 12  # of GraphProto
_TENSOR_NAME = 8  # of TensorProto
_VARINT, _EIGHT_BYTES, _PIECE, _FOUR_BYTES = 0, 1, 2, 5  # kinds of fields on the wire

_Value = int | memoryview


@dataclass(frozen=True)
class Tensor:
    """An input or output: its name, ONNX's number of its element type, its shape, None for what may vary."""

    name: str
    element: int
    shape: tuple[int | None, ...]

    def __str__(self) -> str:
        return f"{self.name} {' × '.join('?' if size is None else str(size) for size in self.shape)}"


@dataclass(frozen=True)
class Graph:
    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]


def read_graph(path: Path) -> Graph:
    """Return the inputs and outputs of a model; weights, which old models list as inputs, are left out.

    Raises FileError if the file is missing, empty or not an ONNX model.
    """
    content = memoryview(read_bytes(path))
    try:
        return _graph(content)
    except (IndexError, ValueError) as error:
        raise FileError("not an ONNX model, or a truncated one", where=str(path)) from error


def _graph(content: memoryview) -> Graph:
    parts = list(_fields(_piece(content, _GRAPH)))
    weights = {_text(_piece(_message(value), _TENSOR_NAME)) for number, value in parts if number == _INITIALIZER}
    inputs = (_tensor(_message(value)) for number, value in parts if number == _INPUT)
    outputs = (_tensor(_message(value)) for number, value in parts if number == _OUTPUT)
    return Graph(tuple(tensor for tensor in inputs if tensor.name not in weights), tuple(outputs))


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
