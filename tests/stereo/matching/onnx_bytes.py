"""ONNX models spelt out in bytes, from the protocol buffers' own description, so that real ones can be run."""


def _varint(number):
    content = b""
    while number > 127:
        content += bytes([number & 127 | 128])
        number >>= 7
    return content + bytes([number])


def field(number, value):
    """Return a field: an integer, or a piece of bytes or text."""
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    content = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def tensor(name, *shape, element=1):
    """Return a ValueInfoProto; a size in words may vary."""
    sizes = b"".join(field(1, field(1 if isinstance(size, int) else 2, size)) for size in shape)
    return field(1, name) + field(2, field(1, field(1, element) + field(2, sizes)))


def node(operation, inputs, output, **attributes):
    """Return a NodeProto; its attributes are integers or lists of them."""
    content = b"".join(field(1, name) for name in inputs) + field(2, output) + field(3, output) + field(4, operation)
    for name, value in attributes.items():
        numbers = field(3, value) if isinstance(value, int) else b"".join(field(8, number) for number in value)
        content += field(5, field(1, name) + numbers + field(20, 2 if isinstance(value, int) else 7))
    return content


def model(nodes, inputs, outputs, weights=()):
    """Return a ModelProto of operator set 13."""
    parts = [*(field(1, part) for part in nodes), field(2, "graph"), *(field(5, field(8, name)) for name in weights)]
    parts += [*(field(11, part) for part in inputs), *(field(12, part) for part in outputs)]
    return field(1, 7) + field(8, field(1, "") + field(2, 13)) + field(7, b"".join(parts))


def difference(rows="rows", columns="columns", channels=3):
    """Return a model whose disparity is left minus right, the mean of the channels."""
    shape = (1, channels, rows, columns)
    nodes = [
        node("Sub", ["left", "right"], "difference"),
        node("ReduceMean", ["difference"], "disparity", axes=[1], keepdims=1),
    ]
    return model(nodes, [tensor("left", *shape), tensor("right", *shape)], [tensor("disparity", 1, 1, rows, columns)])
