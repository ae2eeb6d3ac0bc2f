"""Stable radix sort of u32 keys with i32 values; the count may be known to the device alone."""

import taichi as ti

from render.scan import CPU_CHUNKS, block_exclusive
from render.shared import WORDS

DROPPED = 0xFFFFFFFF  # a key that says: leave this item out
CPU_DIGIT = 12  # [bits] 4096 buckets: their write positions stay in a core's L2 cache
GPU_DIGIT = 8  # [bits] one thread of a block per bucket
BLOCK = 256
WARPS = BLOCK // 32
ITEMS = 8  # per thread of a block
TILE = BLOCK * ITEMS  # items per block


@ti.data_oriented
class RadixSort:
    """Least-significant-digit radix sort of up to `capacity` pairs by the low `bits` of their keys.

    Fill `items`, vec2 i32 = (key's bits, value), and `count`; call `sort()` at the outermost level
    of a kernel; read the first `kept[None]` of `sorted_items` (their keys with keep_keys only).
    With `drop`, items whose key is DROPPED vanish in the first pass, so sorting compacts too.
    Every pass counts digits per block, turns the counts into write positions, and moves the items
    in order: equal keys keep their order on every backend.
    """

    def __init__(self, capacity: int, *, bits: int = 32, drop: bool = False, keep_keys: bool = True):
        self.capacity = capacity
        self.drop = drop
        self.keep_keys = keep_keys
        self.on_gpu = ti.cfg.arch == ti.cuda
        widest = GPU_DIGIT if self.on_gpu else CPU_DIGIT
        self.passes = -(-bits // widest)
        self.digit = GPU_DIGIT if self.on_gpu else -(-bits // self.passes)
        self.buckets = 1 << self.digit
        self.blocks = -(-capacity // TILE) if self.on_gpu else CPU_CHUNKS
        self.item = [ti.Vector.field(2, ti.i32) for _ in range(2)]
        self.count = ti.field(ti.i32)
        self.kept = ti.field(ti.i32)
        self.position = ti.field(ti.i32)  # counts, then write positions; CPU: block-major, GPU: digit-major
        self.bucket_total = ti.field(ti.i32)
        builder = ti.FieldsBuilder()
        for f in self.item:
            builder.dense(ti.i, capacity).place(f)
        builder.dense(ti.i, self.blocks * self.buckets).place(self.position)
        builder.dense(ti.i, self.buckets).place(self.bucket_total)
        builder.place(self.count)
        builder.place(self.kept)
        self.tree = builder.finalize()
        self.items, self.sorted_items = self.item[0], self.item[self.passes % 2]

    def destroy(self) -> None:
        """Give the device memory back; the object must not be used after."""
        self.tree.destroy()

    @ti.func
    def sort(self):
        """Sort the pairs; to be called at the outermost level of a kernel."""
        for p in ti.static(range(self.passes)):
            if ti.static(self.on_gpu):
                self._count_gpu(p)
                self._place_gpu(p)
                self._move_gpu(p)
            else:
                self._count_cpu(p)
                self._place_cpu(p)
                self._move_cpu(p)

    @ti.func
    def _length(self, p: ti.template()) -> ti.i32:
        """Items that pass `p` reads: later passes read what the first one kept."""
        return self.count[None] if ti.static(p == 0) else self.kept[None]

    @ti.func
    def _key(self, p: ti.template(), i: ti.i32) -> ti.u32:
        return ti.cast(self.item[p % 2][i][0], ti.u32)

    @ti.func
    def _move(self, p: ti.template(), i: ti.i32, to: ti.i32):
        """Carry item `i` over to place `to` of the other buffer."""
        if ti.static(self.keep_keys or p < self.passes - 1):
            self.item[1 - p % 2][to][0] = self.item[p % 2][i][0]
        self.item[1 - p % 2][to][1] = self.item[p % 2][i][1]

    @ti.func
    def _bucket(self, key: ti.u32, p: ti.template()) -> ti.i32:
        return ti.cast((key >> (p * self.digit)) & ti.u32(self.buckets - 1), ti.i32)

    @ti.func
    def _is_kept(self, key: ti.u32, p: ti.template()):
        """Whether pass `p` moves an item of this key."""
        return key != ti.u32(DROPPED) if ti.static(self.drop and p == 0) else True

    # ---- CPU: a block is one loop iteration over a long run of items

    @ti.func
    def _count_cpu(self, p: ti.template()):
        ti.loop_config(block_dim=1)
        for b in range(self.blocks):
            for d in range(self.buckets):
                self.position[b * self.buckets + d] = 0
            run = (self._length(p) + self.blocks - 1) // self.blocks
            for i in range(b * run, ti.min((b + 1) * run, self._length(p))):
                key = self._key(p, i)
                if self._is_kept(key, p):
                    slot = b * self.buckets + self._bucket(key, p)
                    self.position[slot] = self.position[slot] + 1  # `+=` would be atomic, four times slower

    @ti.func
    def _place_cpu(self, p: ti.template()):
        so_far = 0
        ti.loop_config(serialize=True)
        for d in range(self.buckets):
            for b in range(self.blocks):
                own = self.position[b * self.buckets + d]
                self.position[b * self.buckets + d] = so_far
                so_far += own
        if ti.static(p == 0):
            self.kept[None] = so_far

    @ti.func
    def _move_cpu(self, p: ti.template()):
        ti.loop_config(block_dim=1)
        for b in range(self.blocks):
            run = (self._length(p) + self.blocks - 1) // self.blocks
            for i in range(b * run, ti.min((b + 1) * run, self._length(p))):
                key = self._key(p, i)
                if self._is_kept(key, p):
                    slot = b * self.buckets + self._bucket(key, p)
                    to = self.position[slot]
                    self.position[slot] = to + 1
                    self._move(p, i, to)

    # ---- CUDA: a block of threads holds TILE items; a warp goes through 32 at a time

    @ti.func
    def _used_blocks(self, p: ti.template()) -> ti.i32:
        return (self._length(p) + TILE - 1) // TILE

    @ti.func
    def _count_gpu(self, p: ti.template()):
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.blocks * BLOCK):
            b, lane = thread // BLOCK, thread % BLOCK
            if b < self._used_blocks(p):  # the same for the whole block
                counts = ti.simt.block.SharedArray((WORDS,), ti.i32)
                ti.simt.block.sync()
                counts[lane] = 0
                ti.simt.block.sync()
                for j in range(ITEMS):
                    i = b * TILE + j * BLOCK + lane
                    if i < self._length(p):
                        key = self._key(p, i)
                        if self._is_kept(key, p):
                            ti.atomic_add(counts[self._bucket(key, p)], 1)
                ti.simt.block.sync()
                self.position[lane * self.blocks + b] = counts[lane]

    @ti.func
    def _place_gpu(self, p: ti.template()):
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.buckets * BLOCK):
            d, lane = thread // BLOCK, thread % BLOCK
            used = self._used_blocks(p)
            run = (used + BLOCK - 1) // BLOCK
            own = 0
            for b in range(lane * run, ti.min((lane + 1) * run, used)):
                own += self.position[d * self.blocks + b]
            before = block_exclusive(own, lane)
            for b in range(lane * run, ti.min((lane + 1) * run, used)):
                count = self.position[d * self.blocks + b]
                self.position[d * self.blocks + b] = before
                before += count
            if lane == BLOCK - 1:
                self.bucket_total[d] = before

    @ti.func
    def _move_gpu(self, p: ti.template()):
        """Rank of an item = items of its digit before it: in earlier blocks, warps, rounds, lanes."""
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.blocks * BLOCK):
            b, lane = thread // BLOCK, thread % BLOCK
            if b == 0 or b < self._used_blocks(p):  # the same for the whole block; block 0 writes `kept`
                everyone = ti.u32(0xFFFFFFFF)
                warp, warp_lane = lane // 32, lane % 32
                below_me = (ti.u32(1) << ti.cast(warp_lane, ti.u32)) - ti.u32(1)
                counts = ti.simt.block.SharedArray((WORDS,), ti.i32)
                ti.simt.block.sync()
                for w in range(WARPS):
                    counts[w * BLOCK + lane] = 0
                start = block_exclusive(self.bucket_total[lane], lane)  # of the digit `lane`; synchronises
                if b == 0 and lane == BLOCK - 1:  # later passes write the same number again
                    self.kept[None] = start + self.bucket_total[lane]
                rank = ti.Vector([0] * ITEMS)
                first = b * TILE + warp * 32 * ITEMS + warp_lane
                for j in ti.static(range(ITEMS)):
                    digit = BLOCK  # an item that does not exist matches no bucket
                    if first + j * 32 < self._length(p):
                        key = self._key(p, first + j * 32)
                        if self._is_kept(key, p):
                            digit = self._bucket(key, p)
                    peers = ti.cast(ti.simt.warp.match_any(everyone, digit), ti.u32)
                    before = 0
                    if digit < BLOCK:
                        before = counts[warp * BLOCK + digit]
                    ti.simt.warp.sync(everyone)
                    rank[j] = before + ti.cast(ti.math.popcnt(peers & below_me), ti.i32)
                    if digit < BLOCK and (peers & below_me) == ti.u32(0):
                        counts[warp * BLOCK + digit] = before + ti.cast(ti.math.popcnt(peers), ti.i32)
                    ti.simt.warp.sync(everyone)
                ti.simt.block.sync()
                at = start + self.position[lane * self.blocks + b]
                for w in range(WARPS):
                    own = counts[w * BLOCK + lane]
                    counts[w * BLOCK + lane] = at
                    at += own
                ti.simt.block.sync()
                for j in ti.static(range(ITEMS)):
                    if first + j * 32 < self._length(p):
                        key = self._key(p, first + j * 32)
                        if self._is_kept(key, p):
                            to = counts[warp * BLOCK + self._bucket(key, p)] + rank[j]
                            self._move(p, first + j * 32, to)
