"""The Taichi runtime: choice of the device, time to the first kernel, care of its cache, and cheap kernel methods.

All that reaches into Taichi's inside stands here, and so does what its fork quadrants does otherwise: with
VRGS_BACKEND=quadrants that is imported under the name taichi (core/__init__.py). Its attributes are bound as Python's
are, it has no graphs, and its cache has other files.

Killed programs or failing disks may leave the cache of compiled kernels damaged. Taichi 1.7.4 notices damage of a
kernel's file, but trusts the index `ticache.tcb`: a flipped bit of a length ends this program and each one after it.
And it never takes up a lock that a killed program has left: from then on every start would compile all kernels anew.

The index: its size [8 bytes], version [3 x 2], size of all kernels [8], number of entries [8]; an entry: length and
text of the key, twice, size, times of creation and of last use [8 each].

`ti.data_oriented` binds kernels in `__getattribute__`: each access to any attribute of such an object then takes 2.5 us
instead of 0.03, and a frame of play makes 400, while the device waits. Here they are bound as Python binds any method.
"""

from __future__ import annotations

import base64
import contextlib
import gc
import importlib
import importlib.util
import os
import re
import signal
import sys
import textwrap
import threading
import time
import warnings
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np

from core.errors import BadInput
from core.program import temporary_folder

QUADRANTS = os.environ.get("VRGS_BACKEND") == "quadrants"
CACHE_PLACE = f"{'QD' if QUADRANTS else 'TI'}_OFFLINE_CACHE_FILE_PATH"  # variable that names the cache's folder
# Compiled kernels are kept between runs, in files of this many bytes in all. Taichi's default of 100 MB is less than a
# few scenes and a preparation compile, and kernels that were pushed out are compiled again, for half a minute.
KERNEL_CACHE = {"offline_cache": True, "offline_cache_max_size_of_files": 1 << 30}
# Taichi leaves common subexpressions and dead stores to LLVM, which removes them as well: kernels compile in half the
# time, a solver's persistent kernel with contacts in a seventh, and run as fast (80 frames of the ring toss and of a
# wooden ring on the CPU: 1.00 times as long; rooms drawn on an H200: 1.00 and 1.01).
COMPILER_OPTIONS = {**KERNEL_CACHE, "opt_level": 0}


class StandIn:
    """Importer that gives the modules of quadrants to whoever imports those of Taichi."""

    def find_spec(self, name: str, path=None, target=None):
        """The module of this name."""
        if name.split(".")[0] == "taichi":
            return importlib.util.spec_from_loader(name, self, is_package=True)

    def create_module(self, spec) -> ModuleType:
        """The module in its place."""
        os.environ.setdefault("ENABLE_QUADRANTS_HEADER_PRINT", "False")
        warnings.filterwarnings("ignore", module=r"quadrants\.")  # of names that the next version changes, and of speed
        module = importlib.import_module(f"quadrants{spec.name.removeprefix('taichi')}")
        self.own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Leave it as it is."""
        module.__spec__ = self.own
        if module.__name__ == "quadrants.lang.kernel_impl":
            module.Kernel.compiled_kernels = property(lambda kernel: kernel.materialized_kernels)


def forget_kernels(runtime) -> None:
    """Let all kernels be compiled anew where fields are freed, as in Taichi: quadrants 1.3.3 and 1.4.0 keep what was
    compiled, which writes into freed memory, and launches by the addresses of objects that are gone."""
    for kernel in runtime.kernels:
        kernel.reset()
        kernel.launch_context_buffer_cache = type(kernel.launch_context_buffer_cache)()


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

    if program() is not None:
        return
    kernels = Path(os.environ.get(CACHE_PLACE) or impl.default_cfg().offline_cache_file_path)
    try:
        kernels.mkdir(parents=True, exist_ok=True)
    except OSError:  # Taichi would try it as the process ends, and crash
        kernels = temporary_folder() / "kernels"
        os.environ[CACHE_PLACE] = str(kernels)
    mend_kernel_cache(kernels)
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


def program():
    """The running program of Taichi; None before it is started."""
    from taichi.lang import impl

    return impl.get_runtime()._prog if QUADRANTS else impl.get_runtime().prog


# LLVM bitcode, assembled (Taichi brings no assembler) from
#     target triple = "nvptx64-nvidia-cuda"
#     define weak_odr void @llvm_nvvm_ex2_approx_ftz_f(float* %p) alwaysinline {
#       %x = load float, float* %p, align 4
#       %y = call float @llvm.nvvm.ex2.approx.ftz.f(float %x)
#       store float %y, float* %p, align 4
#       ret void
#     }
#     declare float @llvm.nvvm.ex2.approx.ftz.f(float)
#     define weak_odr void @load_quad(i64* %at, float* %a, float* %b, float* %c, float* %d) alwaysinline {
#       %n = load i64, i64* %at, align 8
#       %p = inttoptr i64 %n to <4 x float> addrspace(1)*
#       %v = load <4 x float>, <4 x float> addrspace(1)* %p, align 16
#       %v0 = extractelement <4 x float> %v, i32 0                                    and so on for b, c and d
#       store float %v0, float* %a, align 4
#       ret void
#     }
# and store_quad, its reverse.
BITCODE = base64.b64decode(
    "QkPA3jUUAAAFAAAAYgwwJEpZvmaN+7SvC1GATAEAAAAhDAAAcgEAAAsCIQACAAAAFgAAAAeBI5FByARJBhAyOZIBhAwlBQgZHgSLYoAQRQJCkgtC"
    "hBAyFDgIGEsKMkKISHDEISNEEoeMEEGSAmTICLEUIENGiCDJATJChBgqKCqQMXywXJEgxMgAAACJIAAAEQAAADIiCAkgYkYAISskmBAhJSSYEBkn"
    "DIWkkGBCZFwgJGSC4BkBmAGgMAIIjREiqOYIQIHOGIAiIpQDAcMIRDCIwARzBGAAURgAAAcAAAAbiOD/////B0DYwAj/////PwB+APwBIAEU0AcA"
    "SRgAAAIAAAATgmBCIAAAABMmd7AHeKAHfLADOmgDd7CHdCCHdAiHNhiHeiCHcNAIYXKI8OZ0edp99g2pAG0AgCgAAAAAAAAAAADQgCGVphVAAAgA"
    "AAAAAAAAAAAaMKSigyQBgCgAAAAAAAAAAADQgCFVHygJAEQBAAAAAAAAAACABkhsEChaFwAAEIsBAAAAlwAAADMIgBzE4RxmFAE9iEM4hMOMQoAH"
    "eXgHc5hxDOYAD+0QDvSADjMMQh7CwR3OoRxmMAU9iEM4hIMbzAM9yEM9jAM9zHiMdHAHewgHeUiHcHAHenADdniHcCCHGcwRDuyQDuEwD24wD+Pw"
    "DvBQDjMQxB3eIRzYIR3CYR5mMIk7vIM70EM5tAM8vIM8hAM7zPAUdmAHe2gHN2iHcmgHN4CHcJCHcGAHdigHdvgFdniHd4CHXwiHcRiHcpiHeZiB"
    "LO7wDu7gDvXADuwwA2LIoRzkoRzMoRzkoRzcYRzKIRzEgR3KYQbWkEM5yEM5mEM5yEM5uMM4lEM4iAM7lMMvvIM8/II71AM7sMMMx2mHcFiHcnCD"
    "dGgHeGCHdBiHdKCHGc5TD+4AD/JQDuSQDuNAD+EgDuxQDjMgKB3cwR7CQR7SIRzcgR7c4Bzk4R3qAR5mGFE4sEM6nIM7zFAkdmAHe2gHN2CHd3gH"
    "eJhRTPSQD/BQDjMeah7KYRzoIR3ewR1+AR7koRzMIR3wYQZUhYM4zMM7sEM90EM5/MI85EM7iMM7sMOMxQqHeZiHdxiHdAgHeigHcpiBXOMQDuzA"
    "DuVQDvMwI8HSQR7k4RfY4R3eAR5mSBk7sIM9tIMbhMM4jEM5zMM8uME5yMM71AM8zEi0cQgHdmAHcQiHcViHGdvGDuxgD+3gBvAgD+UwD+UgD/ZQ"
    "Dm4QDuMwDuUwD/PgBungDuRQDvgwI+LsYRzCgR3Y4RfsIR3mIR3EIR3YIR3oIR9mIJ07vEM9uAM5lIM5zFi8cHAHd3gHeggHekiHd3AHAACpGAAA"
    "IQAAAAsKciiHd4AHelhwmEM9uMM4sEM50MOC5hzGoQ3oQR7CwR3mIR3oIR3ewR0WNONgDudQD+EgD+RAD+EgD+dQDvSwgIEHeSiHcGAHdniHcQgH"
    "eigHclhwnMM4tAE7pIM9lMMCaxzYIRzc4RzcIBzkYRzcIBzogR7CYRzQoRzIYRzCgR3YAdEQAAAGAAAAB8w8pIM7nAM7lAM9oIM8lEM4kMMBAAAA"
    "YSAAAAsAAAATBAEFMUYMCgAEwaAogmEDYggGQMOBAAADAAAARhA8VhBcZhBgAAAAAAAAAGEgAAAeAAAAEwRBLBAAAAACAAAA5CMAJVAEZQCUHMmg"
    "lQIuYwjBMWxAMMEAjCEIx7ABwQQDMIYwHMMGBBMMwBgCcQwbEEwwABoOBAALAAAA5hA8VhAAZhAEdhAIhhAMRiAAkz0ElUEIFW0RQlWbhFDZNiFU"
    "tzUEDQAAAAAAAAAAYSAAACAAAAATBEEsEAAAAAMAAADkIwAlUARlQDwDAACkHMmglZYYcwxEgBATY45BCBJqYswxCIFCTow5BiFYhg2IJCgADQcC"
    "DgAAAFYQAGYQBHYQCIYQDBYhVLRNCFVtEMJFm4Rw1UYhXLZVCJVtFsJ1m0PQ2IVQ3fYQPEYgABMAAAAAAAAAAHEgAAAEAAAAMg4QIoQApgIoMCuA"
    "A9MCAAAAAABdDAAAHQAAABIDlOgAAAAAbGx2bV9udnZtX2V4Ml9hcHByb3hfZnR6X2ZsbHZtLm52dm0uZXgyLmFwcHJveC5mdHouZmxvYWRfcXVh"
    "ZHN0b3JlX3F1YWQxNC4wLjZudnB0eDY0LW52aWRpYS1jdWRhPHN0cmluZz4AAAAA"
)


class Instructions:
    """Instructions of CUDA that Taichi has no functions for: for kernels, which pass local variables alone.

    exp2(x)                       replaces x by 2^x, by a unit of its own: 2 ulp
    load_quad(at, a, b, c, d)     reads four floats at address `at`, a multiple of 16, in one access
    store_quad(at, a, b, c, d)    writes them
    """

    @cached_property
    def _library(self):
        from taichi.lang.source_builder import SourceBuilder

        return SourceBuilder.from_file(str(bitcode_file()))

    exp2 = property(lambda self: self._library.llvm_nvvm_ex2_approx_ftz_f)
    load_quad = property(lambda self: self._library.load_quad)
    store_quad = property(lambda self: self._library.store_quad)


CUDA = Instructions()


def bitcode_file() -> Path:
    """The file of BITCODE, which Taichi links to kernels. The cache knows them by its path, too: it is always the
    same."""
    path = temporary_folder() / "instructions.bc"
    beside = path.with_suffix(f".{os.getpid()}")
    beside.write_bytes(BITCODE)
    return beside.replace(path)


def launch(method, *numbers: int) -> None:
    """Call a kernel of an object that takes integers alone: Taichi's own way takes 2 us for each, while the device
    waits, this one a fifth of that."""
    if not QUADRANTS:
        kernel, owner = method._primal, weakref.ref(method._kernel_owner)
        known = kernel.mapper.mapping.get((owner, *["#"] * len(numbers)))
        compiled = kernel.compiled_kernels.get((kernel.func, known, kernel.autodiff_mode))
        if compiled is not None:
            context, prog = compiled.make_launch_context(), program()
            for k, number in enumerate(numbers):
                context.set_arg_int((k,), number)
            prog.launch_kernel(prog.compile_kernel(prog.config(), prog.get_device_caps(), compiled), context)
            return
    method(*numbers)


def address_of(array) -> int:
    """Address of a ti.ndarray in the memory of the device."""
    return program().get_ndarray_data_ptr_as_int(array.arr)


def running_arch() -> str:
    """The device on which Taichi runs: "cuda" or "cpu"."""
    import taichi as ti

    return "cuda" if ti.cfg.arch == ti.cuda else "cpu"


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
    """Halve the time in which the front end turns kernels into syntax trees: with a warm cache, most of a start.

    Functions are inlined, and their source text is searched at each call: here once. And Taichi describes locations in
    the source for each expression, and for each field the calls that led to it, in case an error message should need
    them: here in one line, and not at all. Whether a kernel is a method is seen without a look into the source.
    Attributes of classes with kernels are accessed directly, which saves time in every frame as well. And how
    quadrants discards kernels is mended.
    """
    front = importlib.import_module(f"taichi.lang.{'_func_base' if QUADRANTS else 'kernel_impl'}")
    looked_up = ("get_source_info_and_src",) if QUADRANTS else ("getsourcefile", "getsourcelines")
    if hasattr(getattr(front, looked_up[0]), "known"):
        return
    for name in looked_up:
        setattr(front, name, cached_by_code(getattr(front, name)))
    front.textwrap = SimpleNamespace(dedent=textwrap.dedent, fill=lambda line, **_: line.rstrip())
    if QUADRANTS:
        importlib.import_module("taichi.lang.impl").PyQuadrants.clear_compiled_functions = forget_kernels
        return
    from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

    def position(self, node) -> str:
        line = node.lineno + self.lineno_offset
        return f'File "{self.file}", line {line}, in {self.func.func.__name__}:\n{self.src[node.lineno - 1]}\n'

    def inside_class(level_of_class_stackframe: int) -> bool:
        return "__qualname__" in sys._getframe(level_of_class_stackframe - 1).f_locals

    ASTTransformerContext.get_pos_info, front._inside_class = position, inside_class
    for name in ("impl", "matrix", "snode", "_ndarray"):
        importlib.import_module(f"taichi.lang.{name}").get_traceback = lambda stacklevel=1: ""
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


@contextlib.contextmanager
def watch_compilation(note: Callable[[str], None]) -> Iterator[None]:
    """While active, call `note` with the name of each kernel that is about to be compiled, or read from the cache.

    Each is compiled at once. Else the kernels of a graph would all be compiled at its first run, and `note` not called.
    """
    from taichi.lang.kernel_impl import Kernel

    materialize = Kernel.materialize

    def noted(self, key=None, *args, **kwargs):
        key = (self.func, 0, self.autodiff_mode) if key is None else key
        if key in self.compiled_kernels:
            return
        note(self.func.__qualname__)
        materialize(self, key, *args, **kwargs)
        prog = program()
        prog.compile_kernel(prog.config(), prog.get_device_caps(), self.compiled_kernels[key])

    Kernel.materialize = noted
    try:
        yield
    finally:
        Kernel.materialize = materialize


@contextlib.contextmanager
def keep_compiled_kernels() -> Iterator[None]:
    """While active, destroying field trees does not discard compiled kernels.

    Taichi 1.7.4 discards all kernels of a program when one tree is destroyed, since one of them may use it: then the
    next frame compiles everything again. A kernel that uses the tree is cached under the fields or the object that it
    was compiled for, and neither is used again, so that all kernels may stay.
    """
    from taichi.lang import impl

    runtime = impl.get_runtime()
    outermost = "clear_compiled_functions" not in vars(runtime)
    runtime.clear_compiled_functions = lambda: None  # shadows the method
    try:
        yield
    finally:
        if outermost:
            del runtime.clear_compiled_functions


class Graph:
    """Launches of kernels that one call repeats: Taichi's do without Python, those of quadrants one by one."""

    def __init__(self):
        self._launches: list[tuple] = []
        self._graph, self._numbers = None, {}

    def launch(self, kernel, *numbers: int) -> None:
        """Add the launch of a kernel with these numbers (i32), before the first run."""
        self._launches.append((kernel, numbers))

    def run(self) -> None:
        """Repeat the launches."""
        if QUADRANTS:
            for kernel, numbers in self._launches:
                kernel(*numbers)
            return
        if self._graph is None:
            self._record()
        self._graph.run(self._numbers)

    def _record(self) -> None:
        import taichi as ti

        builder = ti.graph.GraphBuilder()
        self._numbers = {f"number{n}": n for _, numbers in self._launches for n in numbers}
        args = {n: ti.graph.Arg(ti.graph.ArgKind.SCALAR, name, ti.i32) for name, n in self._numbers.items()}
        for kernel, numbers in self._launches:
            builder.dispatch(kernel, *(args[n] for n in numbers))
        self._graph = builder.compile()


def is_out_of_memory(error: Exception) -> bool:
    """Test for an exhausted host or GPU memory; Taichi raises a RuntimeError that says so in words."""
    words = ("memory allocation", "out of memory", "out_of_memory", "failed to allocate")
    return isinstance(error, MemoryError) or any(word in str(error).lower() for word in words)


def failure_line(error: Exception) -> str:
    """A line about an error that the machine causes; "" if the program does."""
    if is_out_of_memory(error):
        return "not enough memory; try a smaller picture or fewer Gaussians"
    named = re.search(r"CUDA_ERROR_\w+", str(error))
    who = "quadrants" if QUADRANTS else "Taichi"
    return f"{who} fails on this GPU ({named[0]}): --arch cpu runs without it; see docs/installing.md" if named else ""


INDEX, LOCK = "ticache.tcb", "ticache.lock"
LOCK_AGE = 10.0  # [s] after which its program was killed: it is held for a fraction of a second
VERSION = (1, 7, 4)
HEADER_SIZE, KEY_SIZE = 30, 65
HEX = np.frombuffer(b"0123456789abcdef", np.uint8)
ENTRY = np.dtype([("length", "<u8"), ("key", f"S{KEY_SIZE}"), ("length_2", "<u8"), ("key_2", f"S{KEY_SIZE}"),
                  ("size", "<u8"), ("created", "<u8"), ("used", "<u8")])  # fmt: skip


def mend_kernel_cache(folder: Path) -> None:
    """Remove a lock that nobody holds, and an index that is damaged: kernels are compiled again. Errors are ignored.

    What is younger than LOCK_AGE another program may be writing.
    """
    for name in (LOCK, INDEX):
        with suppress(OSError):
            old = time.time() - (folder / name).stat().st_mtime > LOCK_AGE
            if old and (name == LOCK or not is_sound_index((folder / INDEX).read_bytes())):
                (folder / name).unlink()


def is_sound_index(data: bytes) -> bool:
    """Check an index; those of other versions of Taichi are not judged, and count as sound."""
    if len(data) < HEADER_SIZE:
        return False
    if tuple(np.frombuffer(data, "<u2", 3, 8)) != VERSION:
        return True
    size, (count,) = int.from_bytes(data[:8], "little"), np.frombuffer(data, "<u8", 1, HEADER_SIZE - 8)
    if size != len(data) or HEADER_SIZE + int(count) * ENTRY.itemsize != size:
        return False
    entries = np.frombuffer(data, ENTRY, int(count), HEADER_SIZE)
    lengths = np.concatenate([entries["length"], entries["length_2"]])
    texts = np.ascontiguousarray(entries["key"]).view(np.uint8).reshape(-1, KEY_SIZE)
    keys = (texts[:, 0] == ord("T")).all() and np.isin(texts[:, 1:], HEX).all()
    return bool(keys and (lengths == KEY_SIZE).all() and (entries["key"] == entries["key_2"]).all())


class KernelMethod:
    """Descriptor of a class's kernel: `instance.kernel` is the kernel of that instance."""

    def __init__(self, kernel) -> None:
        from taichi.lang.kernel_impl import _BoundedDifferentiableMethod

        kernel._is_staticmethod = False
        self.kernel, self.bound = kernel, _BoundedDifferentiableMethod

    def __get__(self, instance, owner):
        return self.kernel if instance is None else self.bound(instance, self.kernel)


def bind_kernels(cls: type) -> type:
    """Give a class that `ti.data_oriented` has changed its ordinary access to attributes back."""
    if "__getattribute__" not in vars(cls) or "_data_oriented" not in vars(cls):
        return cls
    for name, value in list(vars(cls).items()):
        if getattr(value, "_is_classkernel", False):
            setattr(cls, name, KernelMethod(value))
    del cls.__getattribute__
    return cls


def bind_kernels_of_all_classes() -> None:
    """Bind the kernels of all classes so far, and of those to come, as Python binds any method."""
    import taichi as ti
    from taichi.lang import kernel_impl

    decorate = kernel_impl.data_oriented
    if getattr(decorate, "binds_kernels", False):
        return

    def data_oriented(cls: type) -> type:
        return bind_kernels(decorate(cls))

    data_oriented.binds_kernels = True
    ti.data_oriented = kernel_impl.data_oriented = data_oriented
    todo = [object]
    while todo:
        cls = todo.pop()
        todo += type.__subclasses__(cls)
        bind_kernels(cls)
