"""Some mutated files for every reader; `make nightly` makes a hundred thousand."""

from dataclasses import replace

from tests.fuzz.hdf5_mutations import claim_text
from tests.fuzz.run import Fuzz, wrong
from tests.fuzz.targets import TARGETS

CASES = 30  # of each reader


def test_every_reader_reads_or_refuses(tmp_path):
    """Some hundreds, in a process of its own: a fault in a C library must not take the tests along."""
    names = [name for name in TARGETS if name != "network"]  # each is a process more; `make nightly` reads them
    fuzz = Fuzz(20, {name: range(CASES) for name in names})
    fuzz.run(jobs=1)
    assert not fuzz.failures, fuzz.failures[:3]
    assert sum(fuzz.tally.values()) == CASES * len(names)
    for kind in ("read", "refused"):  # mutations are neither all in vain nor all too coarse
        assert sum(n for (_, what), n in fuzz.tally.items() if what == kind) > 5 * len(names)


def test_a_length_of_a_text_is_not_believed(tmp_path):
    """HDF5 allocates and clears as many bytes, up to 4 GiB, before it looks where the text is."""
    for name in ("old asset", "old recording"):
        target = replace(TARGETS[name], inside=lambda folder: [claim_text])
        faults = [wrong(target, 0, number, tmp_path) for number in range(12)]
        assert faults == [None] * len(faults)
