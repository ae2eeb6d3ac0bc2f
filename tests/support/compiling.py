"""Record of the kernels that Taichi compiles, or loads from its cache, while something runs."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module


@contextmanager
def compiled() -> Iterator[list[str]]:
    """The names of the kernels that are called for the first time in here, and fields that Python looks into."""
    kernel, access = import_module("taichi.lang.kernel_impl").Kernel, import_module("taichi.lang.field")
    materialize, accessor = kernel.materialize, access.SNodeHostAccessor.__init__
    names: list[str] = []

    def noted(self, key=None, *args, **kwargs):
        if key not in self.compiled_kernels:
            names.append(self.func.__qualname__)
        return materialize(self, key, *args, **kwargs)

    def opened(self, snode):
        names.append("a field that Python looks into")
        accessor(self, snode)

    kernel.materialize, access.SNodeHostAccessor.__init__ = noted, opened
    try:
        yield names
    finally:
        kernel.materialize, access.SNodeHostAccessor.__init__ = materialize, accessor
