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

CHECKPOINT = """
import resource, sys
from pathlib import Path
import numpy as np
from core.errors import BadInput
from prepare.train.trainer import write_checkpoint
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
try:
    write_checkpoint(Path(sys.argv[1]), {f"values_{k}": np.zeros(5000) for k in range(8)}, {})
except BadInput as e:
    sys.exit("full" + str(e).partition("a.h5")[2])
"""


@pytest.mark.parametrize(
    ("program", "told"),
    [(SAVE, "full: File too large\n"), (CHECKPOINT, "full: cannot be written (File too large)\n")],
)
def test_a_full_disk_does_not_crash_the_process_at_its_end(tmp_path, program, told):
    """A limit of the size of files stands for the full disk."""
    pytest.importorskip("resource")
    (tmp_path / "a.h5").write_text("an earlier one")
    words = [sys.executable, "-c", program, tmp_path / "a.h5"]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (1, told)
