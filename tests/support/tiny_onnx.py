"""A tiny ONNX network with the inputs and the output of LaMa, written as protobuf by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np

FLOAT = 1  # TensorProto.DataType


def write_tiny_lama(path: Path, color=(0.2, 0.4, 0.6), *, levels: float = 255.0, image: str = "image") -> None:
    """output = levels * (image + mask * color): the known part as it is, the hole in one colour."""
    fill, scale = np.array(color, np.float32).reshape(1, 3, 1, 1), np.full((1, 1, 1, 1), levels, np.float32)
    nodes = [
        _node("Mul", ["mask", "color"], "painted"),
        _node("Add", [image, "painted"], "filled"),
        _node("Mul", ["filled", "levels"], "output"),
    ]
    graph = b"".join(_field(1, node) for node in nodes) + _field(2, b"tiny")
    graph += _field(5, _tensor("color", fill)) + _field(5, _tensor("levels", scale))
    graph += _field(11, _value(image, (1, 3, 512, 512))) + _field(11, _value("mask", (1, 1, 512, 512)))
    graph += _field(12, _value("output", (1, 3, 512, 512)))
    opset = _field(1, b"") + _number(2, 13)
    path.write_bytes(_number(1, 8) + _field(7, graph) + _field(8, opset))


def _node(kind: str, inputs: list[str], output: str) -> bytes:
    return b"".join(_field(1, name.encode()) for name in inputs) + _field(2, output.encode()) + _field(4, kind.encode())


def _tensor(name: str, values: np.ndarray) -> bytes:
    return (
        b"".join(_number(1, n) for n in values.shape)
        + _number(2, FLOAT)
        + _field(8, name.encode())
        + _field(9, values.tobytes())
    )


def _value(name: str, shape: tuple[int, ...]) -> bytes:
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
