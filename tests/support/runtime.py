"""One Taichi runtime after another in a process."""

import gc
from contextlib import contextmanager


@contextmanager
def runtime(arch: str = "cpu", **options):
    """Taichi, started anew on "cpu" or "cuda", with further options of ti.init.

    What of a runtime is freed only once there is another takes memory of that one with it, and kernels crash. Solvers
    are full of cycles, so it is the garbage collector that frees them: here, between two runtimes.
    """
    import taichi as ti

    from core.runtime import COMPILER_OPTIONS, hasten_front_end

    _end(ti)
    backend = {"cpu": ti.cpu, "cuda": ti.cuda}[arch]
    options = COMPILER_OPTIONS | options
    ti.init(arch=backend, default_fp=ti.f32, random_seed=0, log_level=ti.WARN, **options)
    hasten_front_end()
    yield ti
    _end(ti)


def _end(ti) -> None:
    ti.reset()
    gc.collect()
