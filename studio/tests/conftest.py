"""Fixtures of the program's tests that those of the models take, too."""

from tests.conftest import own_preferences, shared, ti_cpu

__all__ = ["own_preferences", "shared", "ti_cpu"]
