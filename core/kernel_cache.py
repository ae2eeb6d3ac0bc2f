"""Care of Taichi's cache of compiled kernels, which killed programs or failing disks may have left damaged.

Taichi 1.7.4 keeps a file a kernel, whose damage it notices, and an index `ticache.tcb`. It also notices an index that
is too short, but trusts what is in one: a flipped bit of a length ends the program, and would end each one after it.
And it never takes up a lock that a killed program has left: from then on every start would compile all kernels anew.

The index: its size [8 bytes], version [3 x 2], size of all kernels [8], number of entries [8]; an entry: length and
text of the key, twice, size, times of creation and of last use [8 each].
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import numpy as np

INDEX, LOCK = "ticache.tcb", "ticache.lock"
LOCK_AGE = 10.0  # [s] after which its program was killed: it is held for a fraction of a second
VERSION = (1, 7, 4)
HEADER_SIZE, KEY_SIZE = 30, 65
HEX = np.frombuffer(b"0123456789abcdef", np.uint8)
ENTRY = np.dtype([("length", "<u8"), ("key", f"S{KEY_SIZE}"), ("length_2", "<u8"), ("key_2", f"S{KEY_SIZE}"),
                  ("size", "<u8"), ("created", "<u8"), ("used", "<u8")])  # fmt: skip


def mend_kernel_cache(folder: Path) -> None:
    """Remove a lock that nobody holds, and an index that is damaged: kernels are compiled again. Errors are ignored.

    What is younger than LOCK_AGE another program may be writing.
    """
    for name in (LOCK, INDEX):
        with suppress(OSError):
            old = time.time() - (folder / name).stat().st_mtime > LOCK_AGE
            if old and (name == LOCK or not is_sound_index((folder / INDEX).read_bytes())):
                (folder / name).unlink()


def is_sound_index(data: bytes) -> bool:
    """Check an index; those of other versions of Taichi are not judged, and count as sound."""
    if len(data) < HEADER_SIZE:
        return False
    if tuple(np.frombuffer(data, "<u2", 3, 8)) != VERSION:
        return True
    size, (count,) = int.from_bytes(data[:8], "little"), np.frombuffer(data, "<u8", 1, HEADER_SIZE - 8)
    if size != len(data) or HEADER_SIZE + int(count) * ENTRY.itemsize != size:
        return False
    entries = np.frombuffer(data, ENTRY, int(count), HEADER_SIZE)
    lengths = np.concatenate([entries["length"], entries["length_2"]])
    texts = np.ascontiguousarray(entries["key"]).view(np.uint8).reshape(-1, KEY_SIZE)
    keys = (texts[:, 0] == ord("T")).all() and np.isin(texts[:, 1:], HEX).all()
    return bool(keys and (lengths == KEY_SIZE).all() and (entries["key"] == entries["key_2"]).all())
