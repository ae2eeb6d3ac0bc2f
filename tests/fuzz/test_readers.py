"""Some mutated files for every reader; `make nightly` makes a hundred thousand."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from core.errors import BadInput
from tests.fuzz.hdf5_mutations import claim_text
from tests.fuzz.run import Fuzz, wrong
from tests.fuzz.targets import TARGETS, Target, mutated


def test_every_reader_reads_or_refuses(tmp_path):
    """A few hundred, in a process of its own: a fault in a C library must not take the tests along."""
    fuzz = Fuzz(20, {name: range(12) for name in TARGETS})
    fuzz.run(jobs=1)
    assert not fuzz.failures, fuzz.failures[:3]
    assert sum(fuzz.tally.values()) == 12 * len(TARGETS)
    for kind in ("read", "refused"):  # mutations are neither all in vain nor all too coarse
        assert sum(n for (_, what), n in fuzz.tally.items() if what == kind) > 2 * len(TARGETS)


def test_a_length_of_a_text_is_not_believed(tmp_path):
    """HDF5 allocates and clears as many bytes, up to 4 GiB, before it looks where the text is."""
    for name in ("old asset", "old recording"):
        target = replace(TARGETS[name], inside=lambda folder: [claim_text])
        faults = [wrong(target, 0, number, tmp_path) for number in range(12)]
        assert faults == [None] * len(faults)


def multi_line(path):
    error = BadInput(f"{path}: first")
    error.args = (f"{path}: first\nsecond",)
    raise error


FAULTS = {
    "ValueError": lambda path: int("x"),
    "RuntimeWarning": lambda path: np.float32(1e30) * np.float32(1e30),
    "not one line": multi_line,
    "names the file": lambda path: refuse("something"),
    "took": lambda path: np.ones(12_500_000).sum(),  # over 32 MiB: never from memory that the process still holds
}


def refuse(text: str):
    raise BadInput(text)


@pytest.mark.skipif(sys.platform != "linux", reason="memory is measured on Linux only")
@pytest.mark.parametrize("says", FAULTS)
def test_each_fault_of_a_reader_is_found(tmp_path, monkeypatch, says):
    target = Target("broken", lambda folder: [{"a.bin": bytes(64)}], lambda path: None)
    monkeypatch.setitem(TARGETS, "broken", target)
    monkeypatch.setattr("tests.fuzz.run.MEMORY_MAX", 10_000_000)
    assert wrong(target, 0, 1, tmp_path) is None
    assert says in wrong(replace(target, read=FAULTS[says]), 0, 1, tmp_path)
    assert [mutated(target, 0, k, tmp_path) for k in (3, 3)].count(mutated(target, 0, 3, tmp_path)) == 2
