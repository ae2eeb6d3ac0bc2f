"""Start of the Taichi runtime: choice of the device, and time to the first kernel."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import textwrap
import threading
import weakref
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace

from core.errors import BadInput
from core.kernel_cache import mend_kernel_cache
from core.kernel_methods import bind_kernels_of_all_classes

# Compiled kernels are kept between runs, in files of this many bytes in all. Taichi's default of 100 MB is less than a
# few scenes and a preparation compile, and kernels that were pushed out are compiled again, for half a minute.
KERNEL_CACHE = {"offline_cache": True, "offline_cache_max_size_of_files": 1 << 30}
# Taichi leaves common subexpressions and dead stores to LLVM, which removes them as well: kernels compile in half the
# time, a solver's persistent kernel with contacts in a seventh, and run as fast (80 frames of the ring toss and of a
# wooden ring on the CPU: 1.00 times as long; rooms drawn on an H200: 1.00 and 1.01).
COMPILER_OPTIONS = {**KERNEL_CACHE, "opt_level": 0}


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Let a Ctrl-C act after the block: bare `except:` clauses, as in the start of Taichi, would swallow it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came and callable(before):
        before(signal.SIGINT, None)


@interrupts_held()
def start_taichi(arch: str | None = None, seed: int = 0) -> None:
    """Start Taichi once: on CUDA if there is a GPU or `arch` is "cuda", else on the CPU. Raises BadInput."""
    os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")
    import taichi as ti
    from taichi.lang import impl
    from taichi.lang.misc import is_arch_supported

    if impl.get_runtime().prog is not None:
        return
    cache_folder = os.environ.get("TI_OFFLINE_CACHE_FILE_PATH") or impl.default_cfg().offline_cache_file_path
    mend_kernel_cache(Path(cache_folder))
    ti.set_logging_level(ti.ERROR)  # a machine without CUDA is nothing to warn of
    cuda = arch != "cpu" and is_arch_supported(ti.cuda)
    if arch == "cuda" and not cuda:
        raise BadInput("--arch cuda: no CUDA GPU was found")
    wanted = ti.cuda if cuda else ti.cpu
    with contextlib.redirect_stdout(None):  # ti.init prints a banner that no option turns off
        ti.init(arch=wanted, default_fp=ti.f32, random_seed=seed, log_level=ti.ERROR, **COMPILER_OPTIONS)
    if cuda and ti.cfg.arch != ti.cuda:
        raise BadInput("the CUDA GPU could not be started; --arch cpu runs without it")
    hasten_front_end()


def end_taichi() -> None:
    """End Taichi, and give back all memory of the device and of the kernels, so that it can be started anew.

    What holds fields must be let go of before: what of a runtime is freed only once there is another takes memory of
    that one with it. Taichi keeps each kernel that was ever defined, with all that it was defined over; those that
    nothing else refers to are dropped here, or every start would hold 50 to 100 MB more.
    """
    import taichi as ti
    from taichi.lang import impl

    ti.reset()
    kernels = impl.get_runtime().kernels
    known = [weakref.ref(kernel) for kernel in kernels]
    kernels.clear()
    gc.collect()
    kernels += [kernel for reference in known if (kernel := reference()) is not None]


def hasten_front_end() -> None:
    """Halve the time in which Taichi's front end turns kernels into syntax trees: with a warm cache, most of a start.

    Functions are inlined, and their source text is searched and unwrapped at each call: here once. And locations in
    the source are described for each expression, in case an error message should need them: here in one line.
    Attributes of classes with kernels are accessed directly, which saves time in every frame as well.
    """
    from taichi.lang import kernel_impl

    if hasattr(kernel_impl.getsourcelines, "known"):
        return
    kernel_impl.getsourcefile = cached_by_code(kernel_impl.getsourcefile)
    kernel_impl.getsourcelines = cached_by_code(kernel_impl.getsourcelines)
    kernel_impl.textwrap = SimpleNamespace(dedent=textwrap.dedent, fill=cache(textwrap.fill))
    shorten_source_locations()
    bind_kernels_of_all_classes()


def cached_by_code(look_up: Callable) -> Callable:
    """The function of a Python function, kept by its code: closures of one source would keep all that they hold."""
    known: dict = {}

    def cached(function):
        code = function.__code__
        if code not in known:
            known[code] = look_up(function)
        return known[code]

    cached.known = known
    return cached


def shorten_source_locations() -> None:
    """Make Taichi's front end describe locations in one line, without wrapping and underlining the source text."""
    from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

    def position(self, node) -> str:
        line = node.lineno + self.lineno_offset
        return f'File "{self.file}", line {line}, in {self.func.func.__name__}:\n{self.src[node.lineno - 1]}\n'

    ASTTransformerContext.get_pos_info = position


@contextlib.contextmanager
def watch_compilation(note: Callable[[int], None]) -> Iterator[None]:
    """While active, call `note` with the number of the kernel that is about to be compiled, or read from the cache.

    Each is compiled at once. Else the kernels of a graph would all be compiled at its first run, and `note` not called.
    """
    from taichi.lang import impl
    from taichi.lang.kernel_impl import Kernel

    materialize, count = Kernel.materialize, 0

    def noted(self, key=None, *args, **kwargs):
        nonlocal count
        key = (self.func, 0, self.autodiff_mode) if key is None else key
        if key in self.compiled_kernels:
            return
        count += 1
        note(count)
        materialize(self, key, *args, **kwargs)
        prog = impl.get_runtime().prog
        prog.compile_kernel(prog.config(), prog.get_device_caps(), self.compiled_kernels[key])

    Kernel.materialize = noted
    try:
        yield
    finally:
        Kernel.materialize = materialize


def is_out_of_memory(error: Exception) -> bool:
    """Test for an exhausted host or GPU memory; Taichi raises a RuntimeError that says so in words."""
    words = ("memory allocation", "out of memory", "out_of_memory", "failed to allocate")
    return isinstance(error, MemoryError) or any(word in str(error).lower() for word in words)
