"""Exclusive prefix sums of non-negative integers; the count may be known to the device alone."""

import taichi as ti

from core.fields import FieldGroup
from core.lanes import ALL, RUN, WARP, begins

MAX_SUM = (1 << 30) - 1  # sums saturate here: two of them still fit an i32
CPU_CHUNKS = 16  # more than a small machine's cores, few enough to scan one after the other
BLOCK = 256  # threads
SCAN_ITEMS = 4  # per thread of a block
# Length of every block-shared array of a kernel with several loops. Taichi 1.7.4 names a shared array after its
# statement's number, which starts anew in each top-level loop, and links all loops of a kernel together: two arrays
# that draw the same number become one of the smaller size, and writes beyond it fault (CUDA_ERROR_ILLEGAL_ADDRESS, or
# silent damage). With one size there is nothing to confuse.
SHARED_WORDS = 8704  # 34 KiB: counts, and ranks, keys and values of 2048 items to sort; 6 such blocks fit an SM


@ti.func
def saturating_add(a: ti.i32, b: ti.i32) -> ti.i32:
    """min(a + b, MAX_SUM); associative, so it can be scanned."""
    return ti.min(a + b, MAX_SUM)


@ti.func
def block_exclusive(shared: ti.template(), value: ti.i32, lane: ti.i32):
    """Exclusive prefix sum of `value` over the threads of a block of BLOCK, CUDA only.

    Every thread of the block must call it. Uses the first words of `shared`, one for each warp.
    """
    total, member = value, lane % WARP
    for step in ti.static(range(WARP.bit_length() - 1)):
        other = ti.simt.warp.shfl_up_i32(ti.u32(ALL), total, 1 << step)
        if member >= (1 << step):
            total = saturating_add(total, other)
    ti.simt.block.sync()
    if member == WARP - 1:
        shared[lane // WARP] = total
    ti.simt.block.sync()
    before = 0
    for warp in ti.static(range(BLOCK // WARP)):
        if warp < lane // WARP:
            before = saturating_add(before, shared[warp])
    other = ti.simt.warp.shfl_up_i32(ti.u32(ALL), total, 1)
    if member > 0:
        before = saturating_add(before, other)
    return before


@ti.data_oriented
class PrefixSum:
    """Prefix sums over up to `capacity` items.

    Each chunk is summed, the sums are scanned, and each chunk is scanned from its offset. Sums saturate at MAX_SUM, so
    that a caller can detect overflow.
    """

    def __init__(self, capacity: int):
        self.capacity = capacity
        self.on_gpu = ti.cfg.arch == ti.cuda
        self.chunks = -(-capacity // (BLOCK * SCAN_ITEMS)) if self.on_gpu else CPU_CHUNKS
        self.fields = f = FieldGroup()
        self.sums = f.scalar(self.chunks, dtype=ti.i32)
        self.total = f.scalar(dtype=ti.i32)
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def exclusive(self, source: ti.template(), count: ti.template(), offsets: ti.template()):
        """Out: offsets[i] = source.number(0) + ... + source.number(i-1) for i < count[None]; `total` = the sum of all.

        To be called at the outermost level of a kernel.
        """
        if ti.static(self.on_gpu):
            self._exclusive_gpu(source, count, offsets)
        else:
            self._exclusive_cpu(source, count, offsets)

    @ti.func
    def _exclusive_cpu(self, source: ti.template(), count: ti.template(), offsets: ti.template()):
        for step in range(self.chunks * RUN):
            if not begins(step):
                continue
            c = step // RUN
            length = (count[None] + self.chunks - 1) // self.chunks
            total = 0
            for i in range(c * length, ti.min((c + 1) * length, count[None])):
                offsets[i] = source.number(i)
                total = saturating_add(total, offsets[i])
            self.sums[c] = total
        running = 0
        ti.loop_config(serialize=True)
        for c in range(self.chunks):
            own = self.sums[c]
            self.sums[c] = running
            running = saturating_add(running, own)
        self.total[None] = running
        for step in range(self.chunks * RUN):
            if not begins(step):
                continue
            c = step // RUN
            length = (count[None] + self.chunks - 1) // self.chunks
            before = self.sums[c]
            for i in range(c * length, ti.min((c + 1) * length, count[None])):
                value = offsets[i]
                offsets[i] = before
                before = saturating_add(before, value)

    @ti.func
    def _exclusive_gpu(self, source: ti.template(), count: ti.template(), offsets: ti.template()):
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.chunks * BLOCK):
            c, lane = thread // BLOCK, thread % BLOCK
            first = thread * SCAN_ITEMS
            if c * BLOCK * SCAN_ITEMS < count[None]:  # the same for the whole block
                own = 0
                for i in range(first, ti.min(first + SCAN_ITEMS, count[None])):
                    offsets[i] = source.number(i)
                    own = saturating_add(own, offsets[i])
                shared = ti.simt.block.SharedArray((SHARED_WORDS,), ti.i32)
                before = block_exclusive(shared, own, lane)
                if lane == BLOCK - 1:
                    self.sums[c] = saturating_add(before, own)
            elif lane == 0:
                self.sums[c] = 0
        ti.loop_config(block_dim=BLOCK)
        for lane in range(BLOCK):
            length = (self.chunks + BLOCK - 1) // BLOCK
            own = 0
            for c in range(lane * length, ti.min((lane + 1) * length, self.chunks)):
                own = saturating_add(own, self.sums[c])
            shared = ti.simt.block.SharedArray((SHARED_WORDS,), ti.i32)
            before = block_exclusive(shared, own, lane)
            for c in range(lane * length, ti.min((lane + 1) * length, self.chunks)):
                value = self.sums[c]
                self.sums[c] = before
                before = saturating_add(before, value)
            if lane == BLOCK - 1:
                self.total[None] = before
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.chunks * BLOCK):
            c, lane = thread // BLOCK, thread % BLOCK
            first = thread * SCAN_ITEMS
            if c * BLOCK * SCAN_ITEMS < count[None]:
                own = 0
                for i in range(first, ti.min(first + SCAN_ITEMS, count[None])):
                    own = saturating_add(own, offsets[i])
                shared = ti.simt.block.SharedArray((SHARED_WORDS,), ti.i32)
                before = saturating_add(self.sums[c], block_exclusive(shared, own, lane))
                for i in range(first, ti.min(first + SCAN_ITEMS, count[None])):
                    value = offsets[i]
                    offsets[i] = before
                    before = saturating_add(before, value)
