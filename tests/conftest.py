"""Shared fixtures: Taichi on the CPU once per process, and the optional folder of test data."""

import gc
import os
import signal
from pathlib import Path

import pytest

import core  # noqa: F401  before Taichi, in whose place VRGS_BACKEND may put another
from core.runtime import hasten_front_end
from tests.support.runtime import runtime

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")  # also in programs that tests start
hasten_front_end()  # before modules with kernels are imported

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs and their children ignore it

SHARED = Path(__file__).resolve().parents[2] / "shared"


SLOW = ("display", "scenes", "sim")  # folders that take most of the time


def pytest_collection_modifyitems(items):
    """Start the slow folders first, so that two workers finish at about the same time."""
    items.sort(key=lambda item: item.path.parent.name not in SLOW)
    gc.freeze()  # all that is imported by now stays: each of some hundred collections would look through it


@pytest.fixture(scope="module")
def ti_cpu():
    """Taichi on the CPU, initialised once a test file: it holds 512 field trees at most, and a solver has thirty.

    VRGS_TEST_ARCH=cuda: on the GPU.
    """
    with runtime(os.environ.get("VRGS_TEST_ARCH", "cpu")) as ti:
        yield ti


@pytest.fixture(scope="module", autouse=True)
def own_preferences(tmp_path_factory):
    """A folder of settings for each test file, which programs that it starts inherit: none sees the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VRGS_CONFIG", str(tmp_path_factory.mktemp("config")))
        yield


@pytest.fixture(scope="module")
def unwarmed(ti_cpu):
    """Worlds that begin to play without kernels that they do not need yet, of which a play compiles all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("display.world.World.warm_up", lambda world: None)
        yield


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of captures, splats and reference pictures; tests that need it are skipped without it."""
    if not SHARED.is_dir():
        pytest.skip(f"no test data: {SHARED.name}/ does not stand beside the repository")
    return SHARED
