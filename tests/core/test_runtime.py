"""Ctrl-C where Taichi would swallow it, kernels as methods, and its cache after killed programs and failing disks."""

import inspect
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import taichi as ti

from core.runtime import (
    BITCODE,
    CACHE_PLACE,
    ENTRY,
    HEADER_SIZE,
    INDEX,
    KEY_SIZE,
    LOCK,
    LOCK_AGE,
    QUADRANTS,
    Graph,
    KernelMethod,
    bitcode_file,
    interrupts_held,
    is_sound_index,
    launch,
    mend_kernel_cache,
)

ROOT = Path(__file__).resolve().parents[2]


def test_an_interrupt_acts_after_what_would_swallow_it():
    after = []
    with pytest.raises(KeyboardInterrupt), interrupts_held():
        try:
            signal.raise_signal(signal.SIGINT)
            after.append("went on")
        except:  # noqa: E722 as Taichi does
            after.append("swallowed")
    assert after == ["went on"] and signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_kernels_are_those_of_their_instance(ti_cpu):
    @ti.data_oriented
    class Counter:
        def __init__(self, step):
            self.step, self.total = step, ti.field(ti.i32, ())

        @ti.func
        def twice(self):
            return 2 * self.step

        @ti.kernel
        def add(self, n: ti.i32):
            self.total[None] += n * self.twice()

        @property
        def value(self):
            return self.total[None]

    class Named(Counter):
        pass

    one, other = Counter(1), Named(10)
    for counter in (one, other):
        counter.add(3)
    assert (one.value, other.value) == (6, 60)
    assert QUADRANTS or isinstance(vars(Counter)["add"], KernelMethod)  # quadrants binds as Python does by itself
    assert Counter.__getattribute__ is object.__getattribute__  # Taichi's looks into each access


def test_the_source_of_an_inlined_function_is_read_once(ti_cpu, monkeypatch):
    read, lines_of = [], inspect.getsourcelines
    monkeypatch.setattr(
        inspect, "getsourcelines", lambda function: (read.append(function.__name__), lines_of(function))[1]
    )
    total = ti.field(ti.i32, ())

    @ti.func
    def twice(n):
        return 2 * n

    @ti.kernel
    def add(n: ti.i32):
        total[None] += twice(n) + twice(n + 1)

    read.clear()
    add(3)
    assert total[None] == 14 and read.count("twice") == 1


def test_classes_from_before_the_start_are_bound(ti_cpu):
    from sim.state import State

    assert State.__getattribute__ is object.__getattribute__


def test_launches_are_repeated_in_their_order_with_their_numbers(ti_cpu):
    digits = ti.field(ti.i32, ())

    @ti.kernel
    def append(digit: ti.i32):
        digits[None] = 10 * digits[None] + digit

    @ti.kernel
    def append_nine():
        digits[None] = 10 * digits[None] + 9

    graph = Graph()
    for added in ((append, 4), (append, 2), (append_nine,), (append, 4)):
        graph.launch(*added)
    graph.run()
    assert digits[None] == 4294
    digits[None] = 0
    graph.run()
    assert digits[None] == 4294


def test_integers_reach_a_launched_kernel_of_their_object(ti_cpu):
    """At its first run, once it is compiled, and compiled anew."""

    @ti.data_oriented
    class Sum:
        def __init__(self, factor):
            self.factor, self.total = factor, ti.field(ti.i64, ())

        @ti.kernel
        def add(self, small: ti.i32, large: ti.i64):
            self.total[None] += self.factor * (large - small)

    sums = [Sum(factor) for factor in (1, 10)]
    for _ in range(2):
        for one in sums:
            launch(one.add, -3, 1 << 40)
    Sum.add._primal.reset()
    launch(sums[1].add, 5, 6)
    assert [one.total[None] for one in sums] == [2 * ((1 << 40) + 3), 20 * ((1 << 40) + 3) + 10]


def test_bitcode_is_written_anew_to_the_same_place(tmp_path, monkeypatch):
    """Whatever another program has left there."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    path = bitcode_file()
    assert path.read_bytes() == BITCODE and BITCODE.startswith(b"BC\xc0\xde")
    path.write_bytes(BITCODE[:99])
    assert bitcode_file() == path and path.read_bytes() == BITCODE
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("backend, python", [("quadrants", (3, 11)), ("", (3, 14))])
def test_another_back_end_stands_in_for_taichi(tmp_path, backend, python):
    """It is imported if it is asked for, and with a Python that Taichi has no wheel for."""
    package = tmp_path / "quadrants"
    (package / "lang").mkdir(parents=True)
    (package / "__init__.py").write_text("cfg = 'the fork'")
    (package / "math.py").write_text("from . import cfg as vec3")
    (package / "lang" / "__init__.py").touch()
    code = f"import numpy, sys; sys.version_info = {python}; import core, taichi.lang, quadrants\n"
    code += "from taichi.math import vec3; print(vec3, taichi is quadrants)"
    env = os.environ | {"VRGS_BACKEND": backend, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "the fork True\n"


def index(count: int) -> bytes:
    """An index as Taichi 1.7.4 writes it."""
    entries = np.zeros(count, ENTRY)
    entries["length"] = entries["length_2"] = KEY_SIZE
    entries["key"] = entries["key_2"] = [f"T{k:064x}".encode() for k in range(count)]
    size = HEADER_SIZE + count * ENTRY.itemsize
    numbers = (np.uint64(size), *np.array([1, 7, 4], np.uint16), np.uint64(5000), np.uint64(count))
    return b"".join(n.tobytes() for n in numbers) + entries.tobytes()


def test_a_damaged_index_is_told_from_a_sound_one():
    assert is_sound_index(index(0)) and is_sound_index(index(9))
    good = index(5)
    assert not any(is_sound_index(good[:n]) for n in (0, 7, 29, 30, 200, len(good) - 1))
    first = HEADER_SIZE + 8  # a key
    for at in (0, 22, HEADER_SIZE, first, first + 12, first + KEY_SIZE, len(good) - ENTRY.itemsize):
        for bit in (0, 3, 7):
            bad = bytearray(good)
            bad[at] ^= 1 << bit
            assert not is_sound_index(bytes(bad)), (at, bit)
    assert is_sound_index(good[:8] + b"\2\0\0\0\0\0" + good[14:])  # another version's: not ours to judge


def test_a_lock_that_was_left_and_a_damaged_index_go(tmp_path):
    mend_kernel_cache(tmp_path / "none")
    (tmp_path / INDEX).write_bytes(index(3))
    (tmp_path / LOCK).touch()
    mend_kernel_cache(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [LOCK, INDEX]  # a program may be writing just now
    os.utime(tmp_path / LOCK, (0, time.time() - 2 * LOCK_AGE))
    mend_kernel_cache(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [INDEX]
    (tmp_path / INDEX).write_bytes(index(3)[:-1])
    mend_kernel_cache(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [INDEX]
    os.utime(tmp_path / INDEX, (0, time.time() - 2 * LOCK_AGE))
    mend_kernel_cache(tmp_path)
    assert list(tmp_path.iterdir()) == []


PROGRAM = """
import sys
from core.runtime import start_taichi
start_taichi("cpu")
import taichi as ti
a = ti.field(ti.f32, 50)
def kernel(k):
    @ti.kernel
    def add():
        for i in a:
            a[i] = ti.sin(k * 0.1 + i) * a[i] * 0 + k
    return add
for k in range(int(sys.argv[1]), int(sys.argv[2])):
    kernel(k)()
    assert a[3] == k
    print(k, flush=True)
"""


@pytest.mark.parametrize("named", [CACHE_PLACE, "HOME"])
def test_a_cache_that_cannot_be_made_does_not_crash_the_end(tmp_path, named):
    (tmp_path / "file").touch()
    (tmp_path / "kernels.py").write_text(PROGRAM)
    where = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path), named: str(tmp_path / "file" / "below")}
    command = [sys.executable, tmp_path / "kernels.py", "0", "1"]
    run = subprocess.run(command, env=where, capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (0, "0\n", "")
    assert list(tmp_path.glob("vrgs*/kernels/**/*.*"))  # kept for the next time


def program(folder: Path, first: int, last: int) -> subprocess.Popen:
    """A program that compiles kernels, or takes them from the cache, and runs them."""
    source = folder.with_suffix(".py")  # Taichi reads the text of kernels
    source.write_text(PROGRAM)
    environment = {**os.environ, CACHE_PLACE: str(folder), "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, str(source), str(first), str(last)], cwd=ROOT, env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def sound_end(process: subprocess.Popen) -> None:
    """Wait for a program that must end well."""
    _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err[-2000:]


@pytest.mark.long
def test_programs_start_whatever_was_left_in_the_cache(tmp_path):
    sound_end(program(tmp_path, 0, 4))
    written = (tmp_path / INDEX).read_bytes()
    assert is_sound_index(written), "Taichi writes what we read"
    rng = np.random.default_rng(0)
    for trial in range(8):
        damaged = bytearray(written)
        for at in rng.integers(0, len(damaged), 3):
            damaged[at] ^= 1 << rng.integers(8)
        (tmp_path / INDEX).write_bytes(damaged)
        os.utime(tmp_path / INDEX, (0, time.time() - 2 * LOCK_AGE))
        if trial % 2:
            for kernel in tmp_path.glob("*.tic"):
                kernel.write_bytes(kernel.read_bytes()[: rng.integers(kernel.stat().st_size)])
        sound_end(program(tmp_path, 0, 4))


@pytest.mark.long
def test_two_programs_compile_at_once_and_one_is_killed(tmp_path):
    for trial in range(6):
        one, two = program(tmp_path, 0, 12), program(tmp_path, 6, 18)
        one.stdout.readline()
        time.sleep(0.3 * trial)
        one.send_signal(signal.SIGKILL)
        one.wait()
        sound_end(two)
        sound_end(program(tmp_path, 0, 18))
