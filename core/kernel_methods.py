"""Kernels of classes, bound as Python binds any method.

`ti.data_oriented` binds them in `__getattribute__`: each access to any attribute of such an object then takes 2.5 us
instead of 0.03, and a frame of play makes 400, while the device waits.
"""

from __future__ import annotations

from collections.abc import Iterator


class KernelMethod:
    """Descriptor of a class's kernel: `instance.kernel` is the kernel of that instance."""

    def __init__(self, kernel) -> None:
        from taichi.lang.kernel_impl import _BoundedDifferentiableMethod

        kernel._is_staticmethod = False
        self.kernel, self.bound = kernel, _BoundedDifferentiableMethod

    def __get__(self, instance, owner):
        return self.kernel if instance is None else self.bound(instance, self.kernel)


def bind_kernels(cls: type) -> type:
    """Give a class that `ti.data_oriented` has made its ordinary access to attributes back."""
    if "__getattribute__" not in vars(cls) or "_data_oriented" not in vars(cls):
        return cls
    for name, value in list(vars(cls).items()):
        if getattr(value, "_is_classkernel", False):
            setattr(cls, name, KernelMethod(value))
    del cls.__getattribute__
    return cls


def bind_kernels_of_all_classes() -> None:
    """Do so with all classes that there are, and with those that come later."""
    import taichi as ti
    from taichi.lang import kernel_impl

    decorate = kernel_impl.data_oriented
    if getattr(decorate, "binds_kernels", False):
        return

    def data_oriented(cls: type) -> type:
        return bind_kernels(decorate(cls))

    data_oriented.binds_kernels = True
    ti.data_oriented = kernel_impl.data_oriented = data_oriented
    for cls in list(subclasses(object)):
        bind_kernels(cls)


def subclasses(cls: type) -> Iterator[type]:
    """All classes derived from one."""
    for sub in type.__subclasses__(cls):
        yield sub
        yield from subclasses(sub)
