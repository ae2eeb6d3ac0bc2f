"""Field trees that are given back in the midst of play."""

from collections.abc import Iterator
from contextlib import contextmanager

from taichi.lang import impl


@contextmanager
def keeping_kernels() -> Iterator[None]:
    """Trees that are destroyed in here take no kernels with them, for whatever used them is never called again.

    Taichi 1.7.4 forgets all kernels of a program when one tree goes, lest one of them reach for it: then the next frame
    compiles everything anew. A kernel that knows the tree is known by the fields or by the object that it was compiled
    for, and neither comes back, so that the other kernels may stay.
    """
    runtime = impl.get_runtime()
    runtime.clear_compiled_functions = lambda: None  # hides the method
    try:
        yield
    finally:
        del runtime.clear_compiled_functions
