"""Fixtures of the simulation's tests."""

import os

import pytest

from tests.support.runtime import runtime


@pytest.fixture
def fresh_ti_cpu():
    """Taichi started anew for one test, the last of its file: its first solver finds the kernels of another's."""
    with runtime(os.environ.get("VRGS_TEST_ARCH", "cpu")) as ti:
        yield ti
