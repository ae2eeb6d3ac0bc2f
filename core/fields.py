"""Device memory: groups of Taichi fields, their capacities, and transfers to and from the host."""

import ctypes
import math
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import taichi as ti

from core.runtime import CUDA, QUADRANTS, address_of, program

TREES_MAX = 500  # Taichi 1.7.4 has room for 512, and crashes with more; some of its own
_trees: list = []  # of all groups: a tree that is not destroyed outlives its group
FIELD_OWNERS = ("core", "sim", "render")  # packages whose objects hold fields, see `destroy_fields`


def round_up_capacity(count: int) -> int:
    """Capacity for `count` elements, a positive multiple of 64: 4, 5, 6 or 7 times a power of two.

    At most a quarter is wasted, and scenes of similar size share their compiled kernels.
    """
    step = max(64, 1 << max(0, (max(count, 1) - 1).bit_length() - 3))
    return max(step, -(-count // step) * step)


class FieldGroup:
    """Taichi fields that are placed in one tree and freed together.

    Declare fields by `scalar`, `vector` and `matrix`, then `build` once; `destroy` frees them.
    """

    def __init__(self):
        self._builder = ti.FieldsBuilder()
        self._records = None
        self._tree = None

    def scalar(self, *shape: int, dtype=ti.f32):
        """A scalar field of this shape; no shape: a single value."""
        return self._place(ti.field(dtype), shape)

    def vector(self, *shape: int, n: int = 3, dtype=ti.f32, column_major: bool = False):
        """A field of n-vectors; `column_major` stores neighbours along the first of two axes side by side."""
        return self._place(ti.Vector.field(n, dtype), shape, column_major)

    def matrix(self, *shape: int, n: int = 3, m: int = 3):
        """A field of n x m matrices, float32."""
        return self._place(ti.Matrix.field(n, m, ti.f32), shape)

    @contextmanager
    def interleaved(self, *shape: int):
        """Store the fields declared inside, all of this shape, as records, for threads that read them together."""
        self._records = self._dense(shape)
        try:
            yield
        finally:
            self._records = None

    def build(self) -> None:
        """Allocate the declared fields, all zero. Raises RuntimeError if there are too many trees."""
        _trees[:] = [tree for tree in _trees if not tree.destroyed and tree.prog is program()]
        if len(_trees) >= TREES_MAX:
            raise RuntimeError(
                f"{TREES_MAX} groups of fields are alive: destroy() solvers and renderers not needed more"
            )
        self._tree = self._builder.finalize()
        _trees.append(self._tree)

    def destroy(self) -> None:
        """Free the device memory; no kernel may use these fields afterwards."""
        if self._tree is not None and not self._tree.destroyed:
            self._tree.destroy()

    def _place(self, field, shape: tuple[int, ...], column_major: bool = False):
        if self._records is not None:
            node = self._records
        elif column_major:
            node = self._builder.dense(ti.j, shape[1]).dense(ti.i, shape[0])
        else:
            node = self._dense(shape)
        node.place(field)
        return field

    def _dense(self, shape: tuple[int, ...]):
        axes = (ti.i, ti.ij, ti.ijk, ti.ijkl)
        return self._builder.dense(axes[len(shape) - 1], shape) if shape else self._builder


def destroy_fields(owner) -> None:
    """Free all field trees that an object, and the objects it is made of, have placed, each once."""
    seen, todo = set(), [owner]
    while todo:
        at = todo.pop()
        if id(at) in seen:
            continue
        seen.add(id(at))
        if isinstance(at, FieldGroup):
            at.destroy()
        elif isinstance(at, dict):
            todo += at.values()
        elif isinstance(at, (list, tuple)):
            todo += at
        elif type(at).__module__.split(".")[0] in FIELD_OWNERS:
            todo += vars(at).values()


@ti.func
def load_quad(field: ti.template(), i, j):
    """Element (i, j) of a field of 4-vectors that lie at multiples of 16 bytes: one access on CUDA instead of four."""
    value = ti.math.vec4(0.0)
    if ti.static(ti.cfg.arch == ti.cuda and not QUADRANTS):
        at, a, b, c, d = ti.get_addr(field, [i, j]), 0.0, 0.0, 0.0, 0.0
        CUDA.load_quad(at, a, b, c, d)
        value = ti.math.vec4(a, b, c, d)
    else:
        value = field[i, j]
    return value


@ti.func
def store_quad(field: ti.template(), i, j, value):
    """Write such an element."""
    if ti.static(ti.cfg.arch == ti.cuda and not QUADRANTS):
        at, a, b, c, d = ti.get_addr(field, [i, j]), value[0], value[1], value[2], value[3]
        CUDA.store_quad(at, a, b, c, d)
    else:
        field[i, j] = value


@ti.func
def two_sum(a, b):
    """a + b as a float32 and the float32 remainder that it lost, |a| >= |b|.

    In double precision, because the float32 form c = b - ((a + b) - a) is algebraically zero and
    is folded away by the compiler's fast-math.
    """
    s = ti.cast(a, ti.f64) + ti.cast(b, ti.f64)
    high = ti.cast(s, ti.f32)
    return high, ti.cast(s - ti.cast(high, ti.f64), ti.f32)


class Download:
    """A kernel that reads the first n elements of several vec3 fields of one size, as (fields, n, 3) float32."""

    def __init__(self, fields: list):
        self.count = len(fields)

        @ti.kernel
        def read(n: ti.i32, out: ti.types.ndarray(ti.f32, 3)):
            for i in range(n):
                for k, c in ti.static(ti.ndrange(len(fields), 3)):
                    out[k, i, c] = fields[k][i][c]

        self.read = read

    def __call__(self, n: int) -> np.ndarray:
        out = np.zeros((self.count, max(n, 1), 3), np.float32)  # Taichi takes no empty arrays
        self.read(n, out)
        return out[:, :n]


class Upload:
    """Kernel that fills several fields (single values, or one-dimensional) at once, in one loop.

    A kernel or a loop for each field would take as long to compile as a hundred lines of physics.
    """

    def __init__(self, fields: list):
        self.fields = fields
        shapes = [(getattr(f, "n", 1), getattr(f, "m", 1)) for f in fields]
        self.lengths = [int(np.prod(f.shape)) for f in fields]
        lengths, self.widths, columns = self.lengths, [n * m for n, m in shapes], [m for _, m in shapes]
        widths, reals, longest = self.widths, [f.dtype == ti.f32 for f in fields], max(self.lengths)

        @ti.kernel
        def fill(bits: ti.types.ndarray(ti.i32, 1), begin: ti.types.ndarray(ti.i32, 1)):
            for i in range(longest):
                for k in ti.static(range(len(fields))):
                    if i < lengths[k]:
                        for c in ti.static(range(widths[k])):
                            at, bit = begin[k] + i * widths[k] + c, 0
                            if at < begin[k + 1]:
                                bit = bits[at]
                            value = ti.bit_cast(bit, ti.f32) if ti.static(reals[k]) else bit
                            if ti.static(len(fields[k].shape) == 0 and widths[k] == 1):
                                fields[k][None] = value
                            elif ti.static(widths[k] == 1):
                                fields[k][i] = value
                            elif ti.static(columns[k] == 1):
                                fields[k][i][c] = value
                            else:
                                fields[k][i][c // columns[k], c % columns[k]] = value

        self.fill = fill

    def __call__(self, values: list) -> None:
        """Fill the first elements of each field from its values (n, ...); the rest becomes zero."""
        flat, begin = [], [0]
        for field, length, width, value in zip(self.fields, self.lengths, self.widths, values, strict=True):
            words = np.ascontiguousarray(value, np.int32 if field.dtype == ti.i32 else np.float32).reshape(-1)
            if len(words) > length * width:
                raise ValueError(f"{len(words)} words do not fit into {length} elements of {width}")
            flat.append(words.view(np.int32))
            begin.append(begin[-1] + len(words))
        self.fill(np.concatenate([*flat, np.zeros(1, np.int32)]), np.array(begin, np.int32))  # no empty arrays


@dataclass(frozen=True)
class DeviceArray:
    """An array in the memory of a GPU, which torch.as_tensor, cupy.asarray and others take as it is, without a copy.

    `np.asarray` copies it to the host, by `read`.
    """

    address: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]  # [bytes]
    dtype: np.dtype
    read: Callable[[], np.ndarray]

    @property
    def __cuda_array_interface__(self) -> dict:
        place = (self.address, False)
        return {"shape": self.shape, "strides": self.strides, "typestr": self.dtype.str, "data": place, "version": 3}

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return self.read().astype(dtype or self.dtype, copy=False)


def view_of(data, begin: int = 0, end: int | None = None) -> np.ndarray | DeviceArray:
    """The elements begin..end of a dense field, or an ndarray as bytes (..., size of an element), where they are.

    On the CPU a NumPy array, on a GPU a DeviceArray: nothing is copied. It is valid as long as the memory is; do not
    write to it.
    """
    ti.sync()
    if isinstance(data, ti.Ndarray):
        dtype, shape, strides = np.dtype(np.uint8), (*data.shape, data.arr.element_size()), ()
        address = address_of(data)
    else:
        dtype = np.dtype(np.int32 if data.dtype == ti.i32 else np.float32)
        corner = _address(data, 0, 0)
        strides = tuple(_address(data, *at) - corner for at in ((1, 0), (0, 1))[: len(data.shape)])
        address, count = corner + begin * strides[0], (data.shape[0] if end is None else end) - begin
        shape = (count, *data.shape[1:], *((data.n, data.m)[: data.ndim] if hasattr(data, "n") else ()))
    element = shape[len(strides) :]  # its parts lie side by side
    strides = (*strides, *(dtype.itemsize * math.prod(element[k + 1 :]) for k in range(len(element))))
    if ti.cfg.arch == ti.cuda:
        return DeviceArray(address, shape, strides, dtype, lambda: on_host(data, begin, end))
    size = sum(stride * (n - 1) for stride, n in zip(strides, shape, strict=True)) + dtype.itemsize
    return np.ndarray(shape, dtype, (ctypes.c_char * max(size, 0)).from_address(address), strides=strides)


def on_host(data, begin: int, end: int | None) -> np.ndarray:
    """A copy of what `view_of` gives."""
    values = data.to_numpy()
    return values.view(np.uint8).reshape(*data.shape, -1) if isinstance(data, ti.Ndarray) else values[begin:end]


@ti.kernel
def _address(field: ti.template(), i: ti.i32, j: ti.i32) -> ti.u64:
    """Address of an element of a field of one or two axes."""
    return ti.get_addr(field, ti.static([i, j][: len(field.shape)]))
