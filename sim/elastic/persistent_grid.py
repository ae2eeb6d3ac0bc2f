"""Grid of threads that stays on a CUDA device for many substeps: its blocks meet at barriers instead of ending.

A launch costs about 5 us, a barrier among all blocks 1.2 us. All blocks must run at once, or the barrier would wait
forever: one block always fits on a multiprocessor; whether more do is to be tried, see `probe`.
"""

import ctypes
import sys

import taichi as ti

from core.fields import FieldGroup
from core.lanes import from_lane, sum_lanes

# Threads of a block. Taichi compiles for two blocks on a multiprocessor (minnctapersm), so that a thread of a block of
# 256 has 128 registers. With 512 threads it has 64, and the kernels keep most of their variables in memory.
BLOCK = 256
MAX_POLLS = 1 << 17  # of a probe: a tenth of a second, in which all blocks that find a place have long begun


def multiprocessors() -> int:
    """Number of multiprocessors of the first CUDA device."""
    cuda = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    count, device, MULTIPROCESSOR_COUNT = ctypes.c_int(), ctypes.c_int(), 16
    for call in (
        lambda: cuda.cuInit(0),
        lambda: cuda.cuCtxGetDevice(ctypes.byref(device)),
        lambda: cuda.cuDeviceGetAttribute(ctypes.byref(count), MULTIPROCESSOR_COUNT, device),
    ):
        status = call()
        if status != 0:
            raise RuntimeError(f"the CUDA driver says {status} when asked for its multiprocessors")
    return count.value


@ti.data_oriented
class PersistentGrid:
    """`blocks` blocks of `block` threads, and their barrier; `begin` must run in the same kernel before the loop.

    There are so many blocks for each multiprocessor. On the CPU it is one block of one thread, which is a warp of its
    own: for tests. What is shared memory on CUDA, f32[words] and f64[points], then are `words` and `points`.
    """

    def __init__(self, words: int, points: int = 0, *, per_multiprocessor: int = 1):
        self.on_cuda = ti.lang.impl.current_cfg().arch == ti.cuda
        self.block, self.blocks = (BLOCK, per_multiprocessor * multiprocessors()) if self.on_cuda else (1, 1)
        self.warp = min(32, self.block)
        self.threads = self.blocks * self.block
        self.warps = self.threads // self.warp
        g = self._group = FieldGroup()
        self.arrived, self.released = (g.scalar(32, dtype=ti.i32) for _ in range(2))  # a cache line each
        self.missing = g.scalar(dtype=ti.i32)  # 1 if some blocks had to wait for others to end in a probe
        self.words, self.points = g.scalar(words), g.scalar(max(points, 1), dtype=ti.f64)
        g.build()

    @ti.func
    def begin(self):
        self.arrived[0], self.released[0] = 0, 0

    @ti.func
    def probe(self, thread):
        """Find out if all blocks run at once, on CUDA; nothing else may be done in that run.

        Whether they do depends on the registers and the shared memory of the kernel that calls this.
        """
        if thread % self.block == 0 and self.missing[None] == 0:
            ti.atomic_add(self.arrived[0], 1)
            polls = 0
            while polls < MAX_POLLS and ti.atomic_add(self.arrived[0], 0) < self.blocks:
                polls += 1
            if polls == MAX_POLLS:
                self.missing[None] = 1

    @ti.func
    def sync(self):
        """Wait for all threads of the block."""
        if ti.static(self.on_cuda):
            ti.simt.block.sync()

    @ti.func
    def meet(self, thread, rounds, counter: ti.template(), add: ti.template()):
        """Wait for all threads of all blocks, after `rounds` such barriers; the last to come adds to counter[None].

        Returns the number of barriers passed.
        """
        if ti.static(self.on_cuda):
            ti.simt.block.sync()
            if thread % self.block == 0:
                ti.simt.grid.memfence()
                if ti.atomic_add(self.arrived[0], 1) == (rounds + 1) * self.blocks - 1:
                    if ti.static(add != 0):
                        counter[None] += add
                        ti.simt.grid.memfence()
                    ti.atomic_add(self.released[0], 1)
                while ti.atomic_add(self.released[0], 0) <= rounds:
                    pass
                ti.simt.grid.memfence()
            ti.simt.block.sync()
        else:
            counter[None] += add
        return rounds + 1

    @ti.func
    def scattered(self, thread):
        """A number for each thread, such that the first ones are on different multiprocessors, then different warps.

        A few hundred rows in neighbouring threads would keep two multiprocessors busy and all others waiting.
        """
        block, warp, lane = thread // self.block, thread % self.block // self.warp, thread % self.warp
        last = self.block // self.warp - 1 - warp  # a block's first warps have the most vertices
        return (lane * (self.block // self.warp) + last) * self.blocks + block

    @ti.func
    def warp_index(self, thread):
        """Number of the warp of this thread, such that the first ones are on different multiprocessors."""
        return thread % self.block // self.warp * self.blocks + thread // self.block

    @ti.func
    def sum_lanes(self, value, lanes: ti.template()):
        """Sum of a float over each group of `lanes` neighbouring threads, in the first of them."""
        return sum_lanes(value, ti.static(lanes if self.on_cuda else 1))

    @ti.func
    def broadcast(self, value):
        """The float of a warp's first thread, in all of its threads."""
        return from_lane(value, 0, ti.static(self.warp))

    def destroy(self) -> None:
        self._group.destroy()
