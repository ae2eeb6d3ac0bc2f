"""Small ONNX networks, written as protobuf by hand (onnx.proto3)."""

from pathlib import Path

import numpy as np

FLOAT = 1  # TensorProto.DataType
Shape = tuple[int, ...]


class Network:
    """Nodes and constants of a graph with these inputs; tensors are known by their names."""

    def __init__(self, inputs: dict[str, Shape]):
        self._inputs, self._nodes, self._constants = inputs, [], []

    def constant(self, name: str, values: np.ndarray) -> str:
        """A tensor of float32."""
        body = b"".join(_number(1, n) for n in values.shape) + _number(2, FLOAT)
        self._constants.append(body + _field(8, name.encode()) + _field(9, values.astype(np.float32).tobytes()))
        return name

    def node(self, kind: str, *inputs: str) -> str:
        """An operation's output."""
        output = f"{kind.lower()}_{len(self._nodes)}"
        names = b"".join(_field(1, name.encode()) for name in inputs)
        self._nodes.append(names + _field(2, output.encode()) + _field(4, kind.encode()))
        return output

    def write(self, path: Path, output: str, shape: Shape) -> None:
        """Write the network, which gives `output` of that shape."""
        graph = b"".join(_field(1, node) for node in self._nodes) + _field(2, b"tiny")
        graph += b"".join(_field(5, constant) for constant in self._constants)
        graph += b"".join(_field(11, _value(name, dims)) for name, dims in self._inputs.items())
        graph += _field(12, _value(output, shape))
        path.write_bytes(_number(1, 8) + _field(7, graph) + _field(8, _field(1, b"") + _number(2, 13)))


def _value(name: str, shape: Shape) -> bytes:
    dims = b"".join(_field(1, _number(1, n)) for n in shape)
    return _field(1, name.encode()) + _field(2, _field(1, _number(1, FLOAT) + _field(2, dims)))


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _field(field: int, data: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def _varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])
