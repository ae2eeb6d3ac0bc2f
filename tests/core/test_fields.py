"""Fields that are freed while kernels stay compiled."""

import numpy as np
import pytest
import taichi as ti
from taichi.lang import impl

from core.fields import FieldGroup, destroy_fields, load_quad, store_quad
from core.runtime import keep_compiled_kernels


def test_kernels_are_kept_until_the_outermost_context_ends(ti_cpu):
    runtime = impl.get_runtime()
    method = runtime.clear_compiled_functions
    assert "clear_compiled_functions" not in vars(runtime)

    class Holder:
        def __init__(self):
            self.group = FieldGroup()
            self.field = self.group.scalar(4)
            self.group.build()

    with keep_compiled_kernels():
        with keep_compiled_kernels():
            destroy_fields(Holder())
        assert runtime.clear_compiled_functions() is None and "clear_compiled_functions" in vars(runtime)
    assert runtime.clear_compiled_functions == method


def test_other_fields_of_the_same_object_are_written_by_the_same_kernel(ti_cpu):
    """The first ones are freed: what was compiled for them would write into other memory."""

    @ti.data_oriented
    class Holder:
        def make(self, count: int):
            self.group = FieldGroup()
            self.field = self.group.scalar(count)
            self.group.build()

        @ti.kernel
        def fill(self, value: ti.f32):
            for i in self.field:
                self.field[i] = value

    holder, seen = Holder(), []
    for count in (4, 9, 2):
        holder.make(count)
        holder.fill(count)
        seen.append(holder.field.to_numpy().tolist())
        holder.group.destroy()
    assert seen == [4 * [4.0], 9 * [9.0], 2 * [2.0]]


def test_too_many_fields_are_an_error_and_those_that_are_freed_do_not_count(ti_cpu, monkeypatch):
    """Taichi crashes with more trees than it has room for."""
    monkeypatch.setattr("core.fields._trees", [])
    monkeypatch.setattr("core.fields.TREES_MAX", 2)
    groups = [FieldGroup() for _ in range(3)]
    for group in groups:
        group.scalar(4)
    for group in groups[:2]:
        group.build()
    with pytest.raises(RuntimeError, match=r"groups of fields are alive: destroy\(\) solvers"):
        groups[2].build()
    groups[0].destroy()
    groups[2].build()
    groups[1].destroy()
    groups[2].destroy()


def test_quads_are_the_elements_of_their_fields(ti_cpu):
    group = FieldGroup()
    with group.interleaved(2, 3):
        a, b = group.vector(2, 3, n=4), group.vector(2, 3, n=4)
    group.build()

    @ti.kernel
    def fill():
        for v, g in b:
            a[v, g] = ti.math.vec4(1, 2, 3, 10 * v + g)
            store_quad(b, v, g, 2 * load_quad(a, v, g))

    fill()
    np.testing.assert_array_equal(b.to_numpy(), 2 * a.to_numpy())
    np.testing.assert_array_equal(a.to_numpy()[1, 2], [1, 2, 3, 12])
    group.destroy()
