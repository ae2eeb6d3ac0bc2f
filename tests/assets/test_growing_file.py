"""Files that grow in whole steps: the same as in memory, and untouched by a step that finds no space."""

import io

import h5py
import numpy as np
import pytest

from assets.growing_file import GrowingFile


def test_it_is_as_a_file_in_memory_whatever_is_done(tmp_path):
    rng = np.random.default_rng(0)
    twin, file = io.BytesIO(), GrowingFile(tmp_path / "a")
    for _ in range(3000):
        at, count = rng.integers(0, 400, 2)
        act = rng.choice(["write", "write", "read", "truncate", "commit"])
        end = twin.seek(0, 2)
        if act == "truncate":
            size = min(int(at), end)
            assert file.truncate(size) == twin.truncate(size)
        elif act == "commit":
            file.commit()
            assert (tmp_path / "a").read_bytes() == twin.getvalue()
        elif act == "write":
            data = rng.bytes(int(count))
            if at > end:  # a hole of zeros
                twin.write(bytes(int(at) - end))
            twin.seek(int(at))
            file.seek(int(at))
            assert file.write(data) == twin.write(data) and file.tell() == twin.tell()
        else:
            twin.seek(int(at))
            file.seek(int(at))
            assert file.read(int(count)) == twin.read(int(count)).ljust(int(count), b"\0")
    file.close()


def test_a_step_without_space_leaves_the_file_as_it_was_and_hdf5_closes_it(tmp_path):
    """A limit of the size of files stands for the full disk; a part of the step would still have space."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    growing = GrowingFile(tmp_path / "a.h5")
    file = h5py.File(growing, "w")
    data = file.create_dataset("x", (0,), "f8", maxshape=(None,), chunks=(512,))

    def step(rows: int) -> None:
        data.resize(len(data) + rows, axis=0)
        data[-rows:] = np.arange(len(data) - rows, len(data))
        file.flush()
        growing.commit()

    try:
        for _ in range(5):
            step(1000)
        before = (tmp_path / "a.h5").read_bytes()
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 10_000, limits[1]))
        with pytest.raises(OSError, match="File too large"):
            step(5000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    file.close()
    growing.close()
    assert (tmp_path / "a.h5").read_bytes() == before
    with h5py.File(tmp_path / "a.h5") as read:
        assert (read["x"][:] == np.arange(5000)).all()


def test_none_is_made_over_another(tmp_path):
    (tmp_path / "a").write_text("there")
    with pytest.raises(FileExistsError):
        GrowingFile(tmp_path / "a")
    assert (tmp_path / "a").read_text() == "there"
