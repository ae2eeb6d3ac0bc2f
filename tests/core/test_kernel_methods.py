"""Classes of kernels: attributes are accessed directly, kernels are those of their instance."""

import taichi as ti

from core.runtime import KernelMethod, bind_kernels_of_all_classes


def test_kernels_are_those_of_their_instance(ti_cpu):
    bind_kernels_of_all_classes()

    @ti.data_oriented
    class Counter:
        def __init__(self, step):
            self.step, self.total = step, ti.field(ti.i32, ())

        @ti.func
        def twice(self):
            return 2 * self.step

        @ti.kernel
        def add(self, n: ti.i32):
            self.total[None] += n * self.twice()

        @property
        def value(self):
            return self.total[None]

    class Named(Counter):
        pass

    one, other = Counter(1), Named(10)
    for counter in (one, other):
        counter.add(3)
    assert (one.value, other.value) == (6, 60)
    assert isinstance(vars(Counter)["add"], KernelMethod)
    assert Counter.__getattribute__ is object.__getattribute__  # Taichi's looks into each access


def test_classes_from_before_the_start_are_bound(ti_cpu):
    from sim.state import State

    assert State.__getattribute__ is object.__getattribute__
