"""Stable radix sort of u32 keys with i32 values; the count may be known to the device alone."""

import taichi as ti

from core.fields import FieldGroup
from core.lanes import ALL, RUN, WARP, begins, vote
from render.prefix_sum import BLOCK, CPU_CHUNKS, SHARED_WORDS, block_exclusive

DROPPED = 0xFFFFFFFF  # key of an item that is to be left out
CPU_DIGIT_BITS = 12  # 4096 buckets: their write positions stay in a core's L2 cache
GPU_DIGIT_BITS = 8  # one thread of a block per bucket
WARPS = BLOCK // 32
SORT_ITEMS = 8  # per thread of a block
BLOCK_ITEMS = BLOCK * SORT_ITEMS
RANK_BITS = BLOCK_ITEMS.bit_length() - 1
# Offsets in a block's shared memory. The first words belong to block_exclusive until OFFSETS take them.
OFFSETS, KEPT = 0, BLOCK
COUNTS = 2 * BLOCK
KEYS = COUNTS + WARPS * BLOCK
VALUES = KEYS + BLOCK_ITEMS
RANKS = VALUES + BLOCK_ITEMS  # rank of an item in its warp, and its digit above RANK_BITS


@ti.func
def item_of(key: ti.u32, value: ti.i32) -> ti.i64:
    """Key and value in one word."""
    return ti.cast(key, ti.i64) | (ti.cast(value, ti.i64) << 32)


@ti.func
def key_of(item: ti.i64) -> ti.u32:
    """The key: the lower half."""
    return ti.cast(item, ti.u32)


@ti.func
def value_of(item: ti.i64) -> ti.i32:
    """The value: the upper half."""
    return ti.cast(item >> 32, ti.i32)


@ti.data_oriented
class RadixSort:
    """Least-significant-digit radix sort of up to `capacity` pairs by the low `bits` of their keys.

    Fill `items`, i64 of `item_of(key, value)`, and `count`; call `sort()` at the outermost level of a kernel;
    read the first `kept[None]` of `sorted_items` with `key_of` and `value_of`.
    With `drop`, the first pass removes items whose key is DROPPED.
    Each pass counts digits per block, scans the counts into write positions, and moves the items
    in order: equal keys keep their order on every backend.
    """

    def __init__(self, capacity: int, *, bits: int = 32, drop: bool = False):
        self.capacity = capacity
        self.drop = drop
        self.on_gpu = ti.cfg.arch == ti.cuda
        self.passes = -(-bits // (GPU_DIGIT_BITS if self.on_gpu else CPU_DIGIT_BITS))
        self.digit_bits = GPU_DIGIT_BITS if self.on_gpu else -(-bits // self.passes)
        self.buckets = 1 << self.digit_bits
        self.blocks = -(-capacity // BLOCK_ITEMS) if self.on_gpu else CPU_CHUNKS
        self.fields = f = FieldGroup()
        self.item = [f.scalar(capacity, dtype=ti.i64) for _ in range(2)]  # one word: half the accesses of two
        # counts, then write positions; CPU: block-major, GPU: digit-major
        self.position = f.scalar(self.blocks * self.buckets, dtype=ti.i32)
        self.bucket_total = f.scalar(self.buckets, dtype=ti.i32)
        self.count = f.scalar(dtype=ti.i32)
        self.kept = f.scalar(dtype=ti.i32)
        f.build()
        self.items, self.sorted_items = self.item[0], self.item[self.passes % 2]

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def sort(self):
        """Sort the items; to be called at the outermost level of a kernel."""
        for p in ti.static(range(self.passes)):
            if ti.static(self.on_gpu):
                self._count_gpu(p)
                self._scan_gpu(p)
                self._move_gpu(p)
            else:
                self._count_cpu(p)
                self._scan_cpu(p)
                self._move_cpu(p)

    @ti.func
    def _length(self, p: ti.template()) -> ti.i32:
        """Number of items that pass `p` reads: later passes read those that the first one kept."""
        return self.count[None] if ti.static(p == 0) else self.kept[None]

    @ti.func
    def _key(self, p: ti.template(), i: ti.i32) -> ti.u32:
        return key_of(self.item[p % 2][i])

    @ti.func
    def _bucket(self, key: ti.u32, p: ti.template()) -> ti.i32:
        return ti.cast((key >> (p * self.digit_bits)) & ti.u32(self.buckets - 1), ti.i32)

    @ti.func
    def _is_kept(self, key: ti.u32, p: ti.template()):
        """True if pass `p` moves an item of this key."""
        return key != ti.u32(DROPPED) if ti.static(self.drop and p == 0) else True

    # ---- CPU: a block is one loop iteration over a long span of items

    @ti.func
    def _count_cpu(self, p: ti.template()):
        for step in range(self.blocks * RUN):
            if not begins(step):
                continue
            b = step // RUN
            for d in range(self.buckets):
                self.position[b * self.buckets + d] = 0
            span = (self._length(p) + self.blocks - 1) // self.blocks
            for i in range(b * span, ti.min((b + 1) * span, self._length(p))):
                key = self._key(p, i)
                if self._is_kept(key, p):
                    bucket = b * self.buckets + self._bucket(key, p)
                    self.position[bucket] = self.position[bucket] + 1  # `+=` would be atomic, four times slower

    @ti.func
    def _scan_cpu(self, p: ti.template()):
        running = 0
        ti.loop_config(serialize=True)
        for d in range(self.buckets):
            for b in range(self.blocks):
                own = self.position[b * self.buckets + d]
                self.position[b * self.buckets + d] = running
                running += own
        if ti.static(p == 0):
            self.kept[None] = running

    @ti.func
    def _move_cpu(self, p: ti.template()):
        for step in range(self.blocks * RUN):
            if not begins(step):
                continue
            b = step // RUN
            span = (self._length(p) + self.blocks - 1) // self.blocks
            for i in range(b * span, ti.min((b + 1) * span, self._length(p))):
                item = self.item[p % 2][i]
                if self._is_kept(key_of(item), p):
                    bucket = b * self.buckets + self._bucket(key_of(item), p)
                    to = self.position[bucket]
                    self.position[bucket] = to + 1
                    self.item[1 - p % 2][to] = item

    # ---- CUDA: a block of threads holds BLOCK_ITEMS items; a warp goes through 32 at a time

    @ti.func
    def _used_blocks(self, p: ti.template()) -> ti.i32:
        return (self._length(p) + BLOCK_ITEMS - 1) // BLOCK_ITEMS

    @ti.func
    def _count_gpu(self, p: ti.template()):
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.blocks * BLOCK):
            b, lane = thread // BLOCK, thread % BLOCK
            if b < self._used_blocks(p):  # the same for the whole block
                counts = ti.simt.block.SharedArray((SHARED_WORDS,), ti.i32)
                ti.simt.block.sync()
                counts[lane] = 0
                ti.simt.block.sync()
                for j in range(SORT_ITEMS):
                    i = b * BLOCK_ITEMS + j * BLOCK + lane
                    if i < self._length(p):
                        key = self._key(p, i)
                        if self._is_kept(key, p):
                            ti.atomic_add(counts[self._bucket(key, p)], 1)
                ti.simt.block.sync()
                self.position[lane * self.blocks + b] = counts[lane]

    @ti.func
    def _scan_gpu(self, p: ti.template()):
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.buckets * BLOCK):
            d, lane = thread // BLOCK, thread % BLOCK
            used = self._used_blocks(p)
            span = (used + BLOCK - 1) // BLOCK
            own = 0
            for b in range(lane * span, ti.min((lane + 1) * span, used)):
                own += self.position[d * self.blocks + b]
            shared = ti.simt.block.SharedArray((SHARED_WORDS,), ti.i32)
            before = block_exclusive(shared, own, lane)
            for b in range(lane * span, ti.min((lane + 1) * span, used)):
                count = self.position[d * self.blocks + b]
                self.position[d * self.blocks + b] = before
                before += count
            if lane == BLOCK - 1:
                self.bucket_total[d] = before

    @ti.func
    def _peers(self, digit: ti.i32, p: ti.template()) -> ti.u32:
        """Lanes with the same digit: by its bits where lanes differ, and at once where most agree, in the last pass."""
        peers = ti.u32(ALL)
        if ti.static(p + 1 < self.passes):
            for bit in ti.static(range(GPU_DIGIT_BITS + 1)):
                one = (digit >> bit) & 1
                peers &= vote(one, WARP) ^ ti.cast(one - 1, ti.u32)
        else:
            peers = ti.cast(ti.simt.warp.match_any(ti.u32(ALL), digit), ti.u32)
        return peers

    @ti.func
    def _move_gpu(self, p: ti.template()):
        """Rank of an item = items of its digit before it: in earlier blocks, warps, rounds, lanes.

        A block first sorts its items in shared memory: then the items of a digit are written side by side.
        """
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.blocks * BLOCK):
            b, lane = thread // BLOCK, thread % BLOCK
            if b == 0 or b < self._used_blocks(p):  # the same for the whole block; block 0 writes `kept`
                everyone = ti.u32(0xFFFFFFFF)
                warp, warp_lane = lane // 32, lane % 32
                below_me = (ti.u32(1) << ti.cast(warp_lane, ti.u32)) - ti.u32(1)
                shared = ti.simt.block.SharedArray((SHARED_WORDS,), ti.i32)
                start = block_exclusive(shared, self.bucket_total[lane], lane)  # of the digit `lane`; synchronises
                if b == 0 and lane == BLOCK - 1:  # later passes write the same number again
                    self.kept[None] = start + self.bucket_total[lane]
                for w in range(WARPS):
                    shared[COUNTS + w * BLOCK + lane] = 0
                ti.simt.block.sync()
                first = b * BLOCK_ITEMS + warp * 32 * SORT_ITEMS + warp_lane
                for j in range(SORT_ITEMS):
                    digit = BLOCK  # an item that does not exist matches no bucket
                    if first + j * 32 < self._length(p):
                        key = self._key(p, first + j * 32)
                        if self._is_kept(key, p):
                            digit = self._bucket(key, p)
                    peers = self._peers(digit, p)
                    before = 0
                    if digit < BLOCK:
                        before = shared[COUNTS + warp * BLOCK + digit]
                    ti.simt.warp.sync(everyone)
                    rank = before + ti.cast(ti.math.popcnt(peers & below_me), ti.i32)
                    shared[RANKS + j * BLOCK + lane] = rank | digit << RANK_BITS
                    if digit < BLOCK and (peers & below_me) == ti.u32(0):
                        shared[COUNTS + warp * BLOCK + digit] = before + ti.cast(ti.math.popcnt(peers), ti.i32)
                    ti.simt.warp.sync(everyone)
                ti.simt.block.sync()
                own = 0
                for w in range(WARPS):
                    own += shared[COUNTS + w * BLOCK + lane]
                at = block_exclusive(shared, own, lane)  # where the digit `lane` begins in the block
                ti.simt.block.sync()
                shared[OFFSETS + lane] = start + self.position[lane * self.blocks + b] - at
                if lane == BLOCK - 1:
                    shared[KEPT] = at + own
                for w in range(WARPS):
                    warp_count = shared[COUNTS + w * BLOCK + lane]
                    shared[COUNTS + w * BLOCK + lane] = at
                    at += warp_count
                ti.simt.block.sync()
                for j in range(SORT_ITEMS):
                    rank = shared[RANKS + j * BLOCK + lane]
                    digit = rank >> RANK_BITS
                    if digit < BLOCK:
                        to = shared[COUNTS + warp * BLOCK + digit] + (rank & (BLOCK_ITEMS - 1))
                        item = self.item[p % 2][first + j * 32]
                        shared[KEYS + to] = ti.cast(key_of(item), ti.i32)
                        shared[VALUES + to] = value_of(item)
                ti.simt.block.sync()
                for j in range(SORT_ITEMS):
                    i = j * BLOCK + lane
                    if i < shared[KEPT]:
                        key = ti.cast(shared[KEYS + i], ti.u32)
                        to = shared[OFFSETS + self._bucket(key, p)] + i
                        self.item[1 - p % 2][to] = item_of(key, shared[VALUES + i])
