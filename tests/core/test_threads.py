"""Threads for large arrays: results in order, errors passed on."""

import threading

import numpy as np
import pytest

from core.program import batches, in_threads


def test_results_come_in_the_items_order():
    first = threading.Event()

    def wait_for_the_last(k: int) -> int:
        if k == 0:
            first.wait(5)
        if k == 1:
            first.set()
        return k * k

    assert in_threads(wait_for_the_last, range(2)) == [0, 1]
    assert in_threads(wait_for_the_last, []) == []


def test_an_error_in_a_thread_is_raised():
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda k: 1 // k, [1, 0])


@pytest.mark.parametrize("count", [0, 1, 4, 9])
def test_batches_cover_all_items_once(count):
    items = np.arange(count)
    parts = [items[s] for s in batches(count, 4)]
    assert all(0 < len(part) <= 4 for part in parts) and np.array_equal(np.concatenate([[], *parts]), items)
