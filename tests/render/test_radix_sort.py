"""Prefix sums and radix sort against NumPy: exact, stable, count known to the device alone."""

from types import SimpleNamespace

import numpy as np
import pytest

CAPACITY = 70_000
rng = np.random.default_rng(0)

KEYS = {
    "random": rng.integers(0, 2**32, CAPACITY, dtype=np.uint64).astype(np.uint32),
    "few values": rng.integers(0, 7, CAPACITY).astype(np.uint32),
    "all equal": np.full(CAPACITY, 0x80001234, np.uint32),
    "sorted": np.sort(rng.integers(0, 2**32, CAPACITY, dtype=np.uint64)).astype(np.uint32),
    "reversed": np.sort(rng.integers(0, 2**32, CAPACITY, dtype=np.uint64))[::-1].astype(np.uint32),
    "depths": rng.uniform(0.01, 50, CAPACITY).astype(np.float32).view(np.uint32),
}


@pytest.fixture(scope="module")
def machines(ti_cpu):
    """One scan and three sorts; a kernel is compiled once per object, so the tests share them."""
    ti = ti_cpu
    from render.prefix_sum import PrefixSum
    from render.radix_sort import RadixSort

    scan, numbers, offsets = PrefixSum(CAPACITY), ti.field(ti.i32, CAPACITY), ti.field(ti.i32, CAPACITY)
    count = ti.field(ti.i32, ())

    @ti.func
    def number(i):
        return numbers[i]

    source = SimpleNamespace(number=number)

    @ti.kernel
    def run_scan():
        scan.exclusive(source, count, offsets)

    def sorter(**options):
        made = RadixSort(CAPACITY, **options)

        @ti.kernel
        def run():
            made.sort()

        return made, run

    sorts = {"full": sorter(), "dropping": sorter(drop=True), "narrow": sorter(bits=14)}
    return SimpleNamespace(scan=scan, numbers=numbers, offsets=offsets, count=count, run_scan=run_scan, **sorts)


def sort(sorter, run, keys):
    """Sorted values (the items' old places) and keys."""
    items = np.full((sorter.capacity, 2), 3, np.int32)  # what lies beyond the count must not matter
    items[: len(keys), 0] = keys.view(np.int32)
    items[:, 1] = np.arange(sorter.capacity)
    sorter.items.from_numpy(items.view(np.int64)[:, 0])  # the key is the lower half
    sorter.count[None] = len(keys)
    run()
    keys, values = sorter.sorted_items.to_numpy()[: sorter.kept[None], None].view(np.int32).T
    return values, keys.astype(np.uint32)


@pytest.mark.parametrize("count", [0, 1, 2, 15, 16, 17, 1000, 4096, 65_537, CAPACITY])
def test_scan_is_the_sum_of_all_before(machines, count):
    numbers = rng.integers(0, 100, CAPACITY).astype(np.int32)
    machines.numbers.from_numpy(numbers)
    machines.count[None] = count
    machines.run_scan()
    expected = np.concatenate([[0], np.cumsum(numbers[:count])])
    np.testing.assert_array_equal(machines.offsets.to_numpy()[:count], expected[:-1])
    assert machines.scan.total[None] == expected[-1]


def test_scan_stops_at_its_largest_number_instead_of_turning_negative(machines):
    from render.prefix_sum import MAX_SUM

    machines.numbers.from_numpy(np.full(CAPACITY, 100_000, np.int32))
    machines.count[None] = CAPACITY
    machines.run_scan()
    assert machines.scan.total[None] == MAX_SUM
    offsets = machines.offsets.to_numpy()
    np.testing.assert_array_equal(offsets, np.minimum(np.arange(CAPACITY) * 100_000, MAX_SUM))


@pytest.mark.parametrize("name", KEYS)
def test_sort_is_stable_and_exact(machines, name):
    values, keys = sort(*machines.full, KEYS[name])
    expected = np.argsort(KEYS[name], kind="stable")
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(keys, KEYS[name][expected])


@pytest.mark.parametrize("count", [0, 1, 2, 31, 33, 255, 2049, 12_345])
def test_sort_of_fewer_items_than_the_capacity(machines, count):
    values, _ = sort(*machines.full, KEYS["random"][:count])
    np.testing.assert_array_equal(values, np.argsort(KEYS["random"][:count], kind="stable"))


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_dropped_items_vanish(machines, share):
    from render.radix_sort import DROPPED

    keys = np.where(rng.uniform(size=50_001) < share, np.uint32(DROPPED), KEYS["depths"][:50_001])
    values, _ = sort(*machines.dropping, keys)
    kept = np.flatnonzero(keys != DROPPED)
    np.testing.assert_array_equal(values, kept[np.argsort(keys[kept], kind="stable")])


def test_sort_of_short_keys_takes_their_bits_alone(machines):
    keys = KEYS["random"] % np.uint32(1 << 14)
    values, _ = sort(*machines.narrow, keys)
    np.testing.assert_array_equal(values, np.argsort(keys, kind="stable"))
