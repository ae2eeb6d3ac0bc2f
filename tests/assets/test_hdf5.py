"""HDF5 files that are damaged or made to harm: BadInput, with nothing followed, allocated or hung."""

import subprocess
import sys
import zlib

import h5py
import numpy as np
import pytest

from assets.file_access import UNPACK_BASE
from assets.hdf5 import open_hdf5, write_text
from core.errors import BadInput
from tests.assets.test_asset import edited, put, refused, some_asset


def test_nothing_outside_the_file_is_followed(tmp_path):
    means = some_asset().gaussians.means
    with h5py.File(tmp_path / "secret.h5", "w") as secret:
        secret["means"] = means
    (tmp_path / "secret.bin").write_bytes(means.tobytes())

    def external_link(file):
        del file["gaussians/means"]
        file["gaussians/means"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "means")

    def soft_link(file):
        file["elsewhere"] = means
        del file["gaussians/means"]
        file["gaussians/means"] = h5py.SoftLink("/elsewhere")

    def external_storage(file):
        del file["gaussians/means"]
        stored = [(str(tmp_path / "secret.bin"), 0, means.nbytes)]
        file.create_dataset("gaussians/means", means.shape, "f4", external=stored)

    def virtual(file):
        del file["gaussians/means"]
        layout = h5py.VirtualLayout(means.shape, "f4")
        layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "means", means.shape)
        file.create_virtual_dataset("gaussians/means", layout)

    assert "link" in refused(edited(tmp_path, external_link))
    assert "link" in refused(edited(tmp_path, soft_link))
    assert "outside the file" in refused(edited(tmp_path, external_storage))
    assert "outside the file" in refused(edited(tmp_path, virtual))


def test_objects_and_foreign_filters_are_refused(tmp_path):
    texts = put("gaussians/means", np.array([["a", "b", "c"]] * 20, object), dtype=h5py.string_dtype())
    assert "holds object" in refused(edited(tmp_path, texts))
    lzf = put("gaussians/means", some_asset().gaussians.means, compression="lzf")
    assert "filter" in refused(edited(tmp_path, lzf))


def test_sizes_that_the_file_does_not_back_are_refused(tmp_path):
    """Never written chunks cost a file nothing; read naively they would be allocated and filled."""

    def unwritten(file):
        del file["gaussians"]
        for name, width in (("means", 3), ("quats", 4)):
            file.create_dataset(f"gaussians/{name}", (2**31, width), "f4", chunks=(1024, width))

    def huge_chunk(file):
        del file["gaussians/means"]
        options = {"maxshape": (None, 3), "chunks": (UNPACK_BASE, 3), "compression": "gzip"}
        file.create_dataset("gaussians/means", (20, 3), "f4", **options)

    def bomb(file):
        """A chunk of 240 bytes whose deflate stream goes on for 64 MiB."""
        del file["gaussians/means"]
        data = file.create_dataset("gaussians/means", (20, 3), "f4", chunks=(20, 3), compression="gzip")
        data.id.write_direct_chunk((0, 0), zlib.compress(bytes(64 << 20)))

    assert "claims" in refused(edited(tmp_path, unwritten))
    assert "claims" in refused(edited(tmp_path, huge_chunk))
    assert "inflates to more" in refused(edited(tmp_path, bomb))


def with_old_texts(path, libver="earliest"):
    """A file with texts of variable length, as this program wrote them."""
    with h5py.File(path, "w", libver=libver) as file:
        file.attrs["none"] = ""
        for k in range(12):
            file.create_group(f"group{k}").attrs["kind"] = "soft" * k
        for k in range(7):
            file["group3"].attrs[f"key{k}"] = f"text {k}"


def old_texts(path) -> list[str]:
    with open_hdf5(path) as reader:
        kinds = [reader.text(f"group{k}", "kind") for k in range(12)]
        return [reader.text("", "none"), *kinds, *(reader.text("group3", f"key{k}") for k in range(7))]


@pytest.mark.parametrize("libver", ["earliest", "v110", "latest"])
def test_texts_of_variable_length_are_read(tmp_path, libver):
    with_old_texts(tmp_path / "a.h5", libver)
    assert old_texts(tmp_path / "a.h5") == ["", *("soft" * k for k in range(12)), *(f"text {k}" for k in range(7))]


@pytest.mark.parametrize("libver", ["earliest", "latest"])
def test_damaged_texts_of_variable_length_are_refused(tmp_path, libver):
    """HDF5 2.0 loops for ever where the size of an object in their heap is wrong, and allocates any length claimed."""
    with_old_texts(tmp_path / "a.h5", libver)
    data = bytearray((tmp_path / "a.h5").read_bytes())
    heap = data.index(b"GCOL")
    data[heap + 16 + 8 : heap + 16 + 16] = (0x60).to_bytes(8, "little")
    (tmp_path / "a.h5").write_bytes(data)
    with pytest.raises(BadInput, match="is damaged"):
        old_texts(tmp_path / "a.h5")
    data = data.replace(heap.to_bytes(8, "little"), (heap + 8).to_bytes(8, "little"))
    (tmp_path / "a.h5").write_bytes(data)
    with pytest.raises(BadInput):
        old_texts(tmp_path / "a.h5")


@pytest.mark.parametrize("length", [0, 10, 70_000])
def test_texts_of_any_length_come_back(tmp_path, length):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        write_text(file, "about", "ä" * length)
    with open_hdf5(tmp_path / "a.h5") as reader:
        assert reader.text("", "about") == "ä" * length and reader.text("", "none", default="-") == "-"


SAVE = """
import resource, sys
from pathlib import Path
import numpy as np
from assets.hdf5 import new_hdf5, write_dataset
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
try:
    with new_hdf5(Path(sys.argv[1])) as file:
        for k in range(8):
            write_dataset(file, f"values/{k}", np.random.default_rng(k).random(5000), np.float32)
except OSError as e:
    sys.exit(f"full: {e.strerror}")
"""


def test_a_full_disk_does_not_crash_the_process_at_its_end(tmp_path):
    """A limit of the size of files stands for the full disk."""
    pytest.importorskip("resource")
    (tmp_path / "a.h5").write_text("an earlier one")
    words = [sys.executable, "-c", SAVE, tmp_path / "a.h5"]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (1, "full: File too large\n")
