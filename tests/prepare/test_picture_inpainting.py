"""Inpainting of pictures: from patches of the rest, and by networks with LaMa's inputs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import gaussian_filter

from core.errors import BadInput
from prepare.inpaint.picture_inpainting import paint_from_patches
from prepare.onnx_network import LamaNetwork
from tests.support.onnx_network import Network

COLOR = (0.9, 0.5, 0.1)


def write_lama(path, *, levels: float = 255.0, image: str = "image") -> None:
    """A network with the inputs and the output of LaMa's published exports (Carve/LaMa-ONNX, OpenCV's model zoo).

    It gives levels * (image + mask * mean), of all pixels of `image` by channel: the hole in their mean.
    """
    network = Network(inputs={image: (1, 3, 512, 512), "mask": (1, 1, 512, 512)})
    painted = network.node("Mul", "mask", network.node("GlobalAveragePool", image))
    filled = network.node("Add", image, painted)
    output = network.node("Mul", filled, network.constant("levels", np.full((1, 1, 1, 1), levels)))
    network.write(path, output, (1, 3, 512, 512))


def holed(height: int = 90, width: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """A picture in COLOR, black where it is unknown, and that mask."""
    hole = np.zeros((height, width), bool)
    hole[30:60, 40:70] = True
    return np.where(hole[..., None], 0, np.array(COLOR, np.float32)), hole


def test_patches_continue_a_pattern():
    y, x = np.mgrid[:96, :96]
    hole = (x - 50) ** 2 + (y - 47) ** 2 < 14**2
    checks = np.repeat((0.3 + 0.4 * ((x // 12 + y // 12) % 2))[..., None], 3, axis=2).astype(np.float32)
    filled = paint_from_patches(np.where(hole[..., None], 0, checks), hole)
    assert_array_equal(filled[~hole], checks[~hole])
    assert ((filled - checks)[hole] ** 2).mean() < 0.002  # a smooth fill: 0.04
    assert_array_equal(paint_from_patches(checks, np.zeros_like(hole)), checks)
    grain = gaussian_filter(np.random.default_rng(0).normal(size=x.shape), (1.0, 12.0))
    wood = np.repeat((0.5 + 0.1 * grain / grain.std()).clip(0.0, 1.0)[..., None], 3, axis=2).astype(np.float32)
    filled = paint_from_patches(np.where(hole[..., None], 0, wood), hole)
    assert ((filled - wood)[hole] ** 2).mean() < 0.003  # its mean colour: 0.01


def test_a_picture_of_which_little_is_known_is_filled():
    picture, unknown = np.zeros((40, 64, 3), np.float32), np.ones((40, 64), bool)
    picture[0], unknown[0] = COLOR, False
    assert_allclose(paint_from_patches(picture, unknown), np.broadcast_to(COLOR, picture.shape), atol=0.01)


@pytest.mark.parametrize("levels", [1.0, 255.0])
def test_a_lama_network_fills_the_hole(tmp_path, levels):
    """RGB in 0..1, black under the mask, which is 1 in the hole; what it gives is RGB in 0..1 or 0..255."""
    write_lama(tmp_path / "lama.onnx", levels=levels)
    picture, hole = holed()
    filled = LamaNetwork(tmp_path / "lama.onnx")(picture, hole)
    assert_allclose(filled[35:55, 45:65] / COLOR, 0.9, atol=0.02)  # a tenth of the picture is black
    assert_array_equal(filled[~hole], picture[~hole])


@pytest.mark.parametrize("size", [(90, 100), (61, 83), (512, 512), (700, 600)])
def test_a_lama_network_sees_no_dark_rim_of_the_hole(size, monkeypatch):
    """The network takes 512 px; a hole that is no whole number of its pixels does not darken what is beside it."""
    seen = {}

    def run(network, **inputs):
        seen.update(inputs)
        return np.full((3, 512, 512), 0.5)

    monkeypatch.setattr("prepare.onnx_network.OnnxNetwork.__init__", lambda *_: None)
    monkeypatch.setattr("prepare.onnx_network.OnnxNetwork.run", run)
    picture, hole = holed(*size)
    filled = LamaNetwork("lama.onnx")(picture, hole)
    assert filled.shape == picture.shape and np.abs(filled[hole] - 0.5).max() < 1e-6
    image, mask = seen["image"], seen["mask"]
    assert image.shape == (3, 512, 512) and mask.shape == (1, 512, 512) and set(np.unique(mask)) == {0.0, 1.0}
    assert_allclose(image[:, mask[0] == 0].T, np.broadcast_to(COLOR, (int((mask == 0).sum()), 3)), atol=1e-6)
    assert not image[:, mask[0] == 1].any()
    assert mask.mean() == pytest.approx(hole.mean(), rel=0.2)


def test_other_networks_and_files_are_refused(tmp_path):
    (tmp_path / "bad.onnx").write_bytes(b"not a network at all")
    with pytest.raises(BadInput, match="cannot read it as an ONNX network"):
        LamaNetwork(tmp_path / "bad.onnx")
    with pytest.raises(BadInput, match=r"is an \.onnx file"):
        LamaNetwork(tmp_path / "bad.pth")
    write_lama(tmp_path / "other.onnx", image="picture")
    with pytest.raises(BadInput, match="inputs `image` and `mask`"):
        LamaNetwork(tmp_path / "other.onnx")(np.zeros((8, 8, 3), np.float32), np.ones((8, 8), bool))


def test_a_network_that_crashes_opencv_is_refused(tmp_path):
    """Of an operation that it does not know it prints the name, which must be a text."""
    path = tmp_path / "broken.onnx"
    write_lama(path)
    network = LamaNetwork(path)
    path.write_bytes(path.read_bytes().replace(b"\x03Add", b"\x03\xffdd"))
    with pytest.raises(BadInput, match=r"broken\.onnx: OpenCV cannot read it as an ONNX network"):
        LamaNetwork(path)
    network._net._child.process.kill()
    for _ in range(2):
        with pytest.raises(BadInput, match=r"does not run on inputs `image` and `mask` of 512 px \(OpenCV crashed\)"):
            network(*holed())
