"""moderngl on an OpenGL context that somebody else made current."""

from __future__ import annotations

from collections.abc import Callable


def context_of(address: Callable[[str], int | None]):
    """A moderngl context; `address` finds OpenGL's functions by their names, on every platform alike. It is kept as the
    context's `extra`."""
    import moderngl

    class Loader:
        """What moderngl asks of a context."""

        def load_opengl_function(self, name: str) -> int:
            return address(name) or 0

        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

        def release(self):
            pass

    moderngl.init_context(Loader())
    context = moderngl.get_context()
    context.extra = address
    return context
