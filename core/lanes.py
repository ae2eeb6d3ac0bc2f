"""Lanes: the 32 threads of a CUDA warp share a loop and combine their results; on the CPU there is one lane.

A loop over n * lane_count() indices w gives work w // lanes to neighbouring threads of number w % lanes each. All of
them must reach the functions here together.

A CPU's threads share a loop too: Taichi 1.7.4 gives each an equal run of its steps, whatever its `block_dim`, but no
fewer than RUN, and a thread that has done its own takes no other's. So `dealt` mixes what takes time with what does
not, and a loop of few long steps has RUN times as many, of which `step // RUN` where `begins(step)` are the work.
"""

import taichi as ti

WARP = 32
RUN = 512  # steps of a loop, the fewest that a thread of a CPU takes
DEALT = 64  # elements that are dealt at once: neighbours in memory
ALL = 0xFFFFFFFF  # mask of a warp


def lane_count() -> int:
    """Number of lanes on the device that Taichi runs on."""
    return WARP if ti.cfg.arch == ti.cuda else 1


def sharers() -> int:
    """Number of parts in which the threads of the CPU share a loop, at most 8; 1 on a GPU."""
    cfg = ti.cfg
    return 1 if cfg.arch == ti.cuda else min(cfg.cpu_max_num_threads, 8)


@ti.func
def dealt(step, n):
    """The element of a step of a loop over n: on a CPU each thread's run holds every so many blocks of elements."""
    element = step
    parts = ti.static(sharers())
    if ti.static(parts > 1):
        run = n // (parts * DEALT) * DEALT
        if step < parts * run:
            part = 0
            for k in ti.static(range(1, parts)):
                part += ti.cast(step >= k * run, ti.i32)
            own = step - part * run
            element = own + (ti.raw_div(own, DEALT) * (parts - 1) + part) * DEALT
    return element


@ti.func
def begins(step):
    """True for the steps that do the work of a loop of few long ones."""
    return step % RUN == 0


@ti.func
def sum_lanes(value, lanes: ti.template()):
    """Sum of a float over each group of `lanes` neighbouring threads, a power of two, in the first of them."""
    total = value
    for half in ti.static([lanes >> (k + 1) for k in range(lanes.bit_length() - 1)]):
        total += ti.simt.warp.shfl_down_f32(ti.u32(ALL), total, half)
    return total


@ti.func
def from_lane(value, k, lanes: ti.template()):
    """The float of lane k, in all lanes."""
    result = value
    if ti.static(lanes > 1):
        result = ti.simt.warp.shfl_sync_f32(ti.u32(ALL), value, k)
    return result


@ti.func
def vector_from_lane(value, k, lanes: ti.template()):
    """The vec3 of lane k, in all lanes."""
    result = value
    for axis in ti.static(range(3)):
        result[axis] = from_lane(value[axis], k, lanes)
    return result


@ti.func
def int_from_lane(value, k, lanes: ti.template()):
    """The int of lane k, in all lanes."""
    result = value
    if ti.static(lanes > 1):
        result = ti.simt.warp.shfl_sync_i32(ti.u32(ALL), value, k)
    return result


@ti.func
def vote(chosen, lanes: ti.template()):
    """Bits of the chosen lanes, in all lanes."""
    bits = ti.cast(chosen, ti.u32)
    if ti.static(lanes > 1):
        bits = ti.cast(ti.simt.warp.ballot(ti.cast(chosen, ti.i32)), ti.u32)
    return bits


@ti.func
def first_of(bits):
    """The lowest of these bits, of which there must be one."""
    return ti.cast(ti.math.popcnt((bits - ti.u32(1)) & ~bits), ti.i32)


@ti.func
def rank_lanes(chosen, lane, lanes: ti.template()):
    """Number of chosen lanes before this one, and of all chosen lanes."""
    bits = vote(chosen, lanes)
    before = ti.math.popcnt(bits & ((ti.u32(1) << ti.cast(lane, ti.u32)) - ti.u32(1)))
    return ti.cast(before, ti.i32), ti.cast(ti.math.popcnt(bits), ti.i32)


@ti.func
def sums_before(value, lane, lanes: ti.template()):
    """Sum of an int over the lanes before this one, and over all."""
    total = value
    for distance in ti.static([1 << k for k in range(lanes.bit_length() - 1)]):
        other = ti.simt.warp.shfl_up_i32(ti.u32(ALL), total, distance)
        if lane >= distance:
            total += other
    return total - value, int_from_lane(total, lanes - 1, lanes)


@ti.func
def sync_lanes(lanes: ti.template()):
    """Wait for all lanes, and see what they have written."""
    if ti.static(lanes > 1):
        ti.simt.warp.sync(ti.u32(ALL))


@ti.func
def max_lanes(value, lanes: ti.template()):
    """Largest of a float over each group of `lanes` neighbouring threads, in the first of them."""
    most = value
    for half in ti.static([lanes >> (k + 1) for k in range(lanes.bit_length() - 1)]):
        most = ti.max(most, ti.simt.warp.shfl_down_f32(ti.u32(ALL), most, half))
    return most


@ti.func
def max_by_key(field: ti.template(), key, value, lane, lanes: ti.template()):
    """field[key] = max(field[key], value) for each lane; one atomic operation a warp where the keys are equal."""
    most, writes = value, True
    if ti.static(lanes > 1):
        first = ti.simt.warp.shfl_sync_i32(ti.u32(ALL), key, 0)
        if ti.simt.warp.all_nonzero(ti.u32(ALL), ti.cast(key == first, ti.i32)):
            most = max_lanes(value, lanes)
            writes = lane == 0
    if writes and most > field[key]:
        ti.atomic_max(field[key], most)
