"""Small binary glTF files for tests, written by their own few lines."""

import json
import struct

import numpy as np

TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}


class Builder:
    """Collects arrays and images into one buffer."""

    def __init__(self):
        self.binary, self.views, self.accessors, self.images = b"", [], [], []

    def view(self, data: bytes, **options) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **options})
        self.binary += data
        return len(self.views) - 1

    def array(self, values, dtype: str = "f4", **options) -> int:
        values = np.asarray(values)
        values = values.reshape(len(values), -1)
        view = self.view(values.astype(f"<{dtype}").tobytes())
        kind = {"componentType": CODES[dtype], "count": len(values), "type": TYPES[values.shape[1]]}
        self.accessors.append({"bufferView": view, **kind, **options})
        return len(self.accessors) - 1

    def image(self, data: bytes) -> int:
        self.images.append({"bufferView": self.view(data), "mimeType": "image/png"})
        return len(self.images) - 1

    def json(self, **scene) -> dict:
        found = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(self.binary)}]}
        return found | {"bufferViews": self.views, "accessors": self.accessors, "images": self.images} | scene

    def write(self, path, scene: dict):
        path.write_bytes(packed(json.dumps(scene).encode(), self.binary))
        return path


def packed(text: bytes, binary: bytes) -> bytes:
    """The container round a JSON text and a buffer."""
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


TIMES = np.array([0.5, 1.0, 2.0])
TURNS = np.array([[0, 0, 0, 1], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], [0, 0, 0, 1]])  # xyzw: 0, 90, 0 degrees about z


def bar(seed: int = 0):
    """A square bar along y, 0.1 x 1 x 0.1 m, of two joints: the upper one, at 0.5 m, turns by 90 degrees and back.

    Out.  the Builder and the scene's JSON, to be written, or damaged first
    """
    import cv2

    b = Builder()
    ring = np.array([[-0.05, 0, -0.05], [0.05, 0, -0.05], [0.05, 0, 0.05], [-0.05, 0, 0.05]])
    levels = np.linspace(0, 1, 21)
    x = np.concatenate([ring + [0, y, 0] for y in levels])
    side = [[4 * k + i, 4 * k + 4 + i, 4 * k + (i + 1) % 4] for k in range(20) for i in range(4)]
    side += [[4 * k + (i + 1) % 4, 4 * k + 4 + i, 4 * k + 4 + (i + 1) % 4] for k in range(20) for i in range(4)]
    faces = np.array([*side, [0, 1, 2], [0, 2, 3], [80, 82, 81], [80, 83, 82]])
    upper = np.clip((np.repeat(levels, 4) - 0.45) / 0.1, 0, 1)
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, 1, 3] = -0.5
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[:, 1] = (0, 0, 255)  # BGR: black on the left, red on the right
    attributes = {
        "POSITION": b.array(x),
        "JOINTS_0": b.array(np.tile([0, 1, 0, 0], (len(x), 1)), "u1"),
        "WEIGHTS_0": b.array(np.stack([255 * (1 - upper), 255 * upper, 0 * upper, 0 * upper], 1).round(), "u1",
                             normalized=True),
        "TEXCOORD_0": b.array(np.where(x[:, [0, 1]] > 0, 0.75, 0.25)),
    }  # fmt: skip
    primitive = {"attributes": attributes, "indices": b.array(faces.ravel(), "u2"), "material": 0}
    samplers = [{"input": b.array(TIMES), "output": b.array(TURNS), "interpolation": "LINEAR"}]
    nodes = [{"name": "lower", "children": [1]}, {"name": "upper", "translation": [0, 0.5, 0]}, {"mesh": 0, "skin": 0}]
    scene = {
        "nodes": nodes,
        "meshes": [{"primitives": [primitive]}],
        "skins": [{"joints": [0, 1], "inverseBindMatrices": b.array(np.swapaxes(bind, 1, 2))}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": b.image(cv2.imencode(".png", pixels)[1].tobytes())}],
        "animations": [
            {"samplers": samplers, "channels": [{"sampler": 0, "target": {"node": 1, "path": "rotation"}}]},
        ],
    }  # fmt: skip
    return b, b.json(**scene)
