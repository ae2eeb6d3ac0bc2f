"""Fields that are freed while kernels stay compiled."""

from taichi.lang import impl

from core.fields import FieldGroup, destroy_fields, keep_compiled_kernels


def test_kernels_are_kept_until_the_outermost_context_ends(ti_cpu):
    runtime = impl.get_runtime()
    method = runtime.clear_compiled_functions
    assert "clear_compiled_functions" not in vars(runtime)

    class Holder:
        def __init__(self):
            self.group = FieldGroup()
            self.field = self.group.scalar(4)
            self.group.build()

    with keep_compiled_kernels():
        with keep_compiled_kernels():
            destroy_fields(Holder())
        assert runtime.clear_compiled_functions() is None and "clear_compiled_functions" in vars(runtime)
    assert runtime.clear_compiled_functions == method
