"""Distances on a grid against SciPy's, which are exact, too."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from prepare.cage.distance_transform import FAR, distance, squared_distance

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("seed", range(12))
def test_distances_are_exact(ti_cpu, seed):
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=rng.integers(1, 40, 3)) < rng.choice([0.5, 0.05, 0.003])
    mask.flat[rng.integers(mask.size)] = True
    true = distance_transform_edt(~mask)
    assert (squared_distance(mask) == np.rint(true**2)).all()
    np.testing.assert_allclose(distance(mask), true, rtol=1e-6)
    reach = rng.uniform(0, 12)
    np.testing.assert_allclose(distance(mask, reach), np.where(true > reach, np.inf, true), rtol=1e-6)


def test_without_any_cell_all_is_far(ti_cpu):
    assert (squared_distance(np.zeros((4, 5, 6), bool)) >= FAR).all()


def test_a_view_is_as_good_as_an_array(ti_cpu):
    mask = np.random.default_rng(1).uniform(size=(20, 22, 24)) < 0.1
    assert (squared_distance(mask[::2, 1:, ::3]) == squared_distance(mask[::2, 1:, ::3].copy())).all()


def test_the_grids_go_with_their_runtime():
    """What outlived its runtime would free memory of the next one: in a process of its own, two runtimes."""
    program = """
from gc import collect
import subprocess
import sys
from pathlib import Path

import numpy as np
import taichi as ti
from prepare.cage.distance_transform import _kept, squared_distance
mask = np.zeros((3, 4, 5), bool)
mask[0, 0, 0] = True
for _ in range(2):
    ti.init(arch=ti.cpu, offline_cache=True)
    assert squared_distance(mask)[-1, -1, -1] == 2 * 2 + 3 * 3 + 4 * 4 and len(_kept) == 1
    ti.reset()
    collect()
    assert len(_kept) == 0
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT)
