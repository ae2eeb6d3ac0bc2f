"""Writing of HDF5 files where the disk is full."""

import subprocess
import sys

import pytest

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
    ended = subprocess.run([sys.executable, "-c", SAVE, tmp_path / "a.h5"], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (1, "full: File too large\n")
