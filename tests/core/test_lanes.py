"""Loops that the threads of a CPU share."""

import numpy as np
import pytest
import taichi as ti

from core.lanes import DEALT, dealt, sharers


@pytest.mark.parametrize("n", [1, 1000, 100_001])
def test_each_element_is_dealt_once_and_each_run_of_steps_gets_some_of_every_quarter(ti_cpu, n):
    elements = ti.field(ti.i32, n)

    @ti.kernel
    def deal(count: ti.i32):
        for k in range(count):
            elements[k] = dealt(k, count)

    deal(n)
    order, parts = elements.to_numpy(), sharers()
    assert np.array_equal(np.sort(order), np.arange(n))
    if n > 16 * DEALT * parts:
        for run in np.array_split(order, parts):
            assert np.bincount(run * 4 // n, minlength=4).min() > len(run) / 8
