"""Reading of HDF5 files from untrusted sources: nothing is followed out of the file and every size is bounded.

HDF5 can point to other files (external and soft links, external and virtual storage), load plug-in
filters, hold pickled objects, and claim sizes that its bytes do not back. All of that is refused
before a dataset is read.
"""

from __future__ import annotations

import io
import json
import mmap
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from assets.file_access import UNPACK_BASE, file_size, unpack_bound
from core.errors import BadInput

FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
HEAP = b"GCOL\1\0\0\0"  # eight bytes: no chance match in a file of less than an exabyte
CHUNK_ENTRY_MIN = 8  # [bytes] of a stored chunk's entry in the index: its address
TEXT_MAX = 1 << 20  # [characters] of a text attribute


class Hdf5Reader:
    """An open HDF5 file. Every method raises BadInput with one line that names the file and the defect."""

    def __init__(self, path: Path, file: h5py.File, size: int):
        self.path = path
        self._file = file
        self._size = size
        self._unpack_left = unpack_bound(size)  # [bytes] that may still be unpacked

    def error(self, defect: str) -> BadInput:
        """The error to raise."""
        return BadInput(f"{self.path}: {defect}")

    def has(self, name: str) -> bool:
        """True if a group or dataset of that name is there."""
        return self._find(name) is not None

    def has_attribute(self, name: str, key: str) -> bool:
        """True if the group or dataset `name` ("" is the root) is there and has the attribute."""
        node = self._find(name) if name else self._file
        return node is not None and key in node.attrs

    def _find(self, name: str):
        node = self._file
        for part in name.split("/"):
            if not isinstance(node, h5py.Group):
                return None
            link = node.get(part, getlink=True)
            if link is None:
                return None
            if not isinstance(link, h5py.HardLink):
                raise self.error(f"{name} is a link; links are not followed")
            node = node[part]
        return node

    def array(self, name: str, kind: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """A dataset of numbers as it is stored. `kind` is "f" or "iu"; None in `shape` stands for any length."""
        data = self._find(name)
        if not isinstance(data, h5py.Dataset):
            raise self.error(f"missing dataset {name!r}")
        if data.dtype.kind not in kind or data.dtype.itemsize > 8:
            raise self.error(
                f"{name} holds {data.dtype}, expected {'floating-point numbers' if kind == 'f' else 'integers'}"
            )
        got = data.shape
        if got is None or len(got) != len(shape) or any(s not in (None, g) for s, g in zip(shape, got, strict=True)):
            expected = ", ".join("*" if s is None else str(s) for s in shape)
            raise self.error(f"{name} has shape {got}, expected ({expected})")
        self._bound(name, data)
        return data[()]

    def floats(self, name: str, shape: tuple[int | None, ...], dtype=np.float32) -> np.ndarray:
        """A dataset of floating-point numbers, not checked to be finite."""
        with np.errstate(over="ignore", invalid="ignore"):  # an overflow becomes infinite
            return self.array(name, "f", shape).astype(dtype, copy=False)

    def indices(self, name: str, shape: tuple[int | None, ...], dtype=np.int32) -> np.ndarray:
        """A dataset of integers from 0 to the largest of `dtype`."""
        values = self.array(name, "iu", shape)
        if values.size and (values.min() < 0 or values.max() > np.iinfo(dtype).max):
            raise self.error(f"{name} holds an index out of range")
        return values.astype(dtype)

    def _bound(self, name: str, data: h5py.Dataset) -> None:
        """Refuse storage outside the file, foreign filters, and sizes that the file cannot back."""
        if data.external or data.is_virtual:
            raise self.error(f"{name} is stored outside the file")
        plist = data.id.get_create_plist()
        filters = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}
        if filters - FILTERS:
            raise self.error(f"{name} uses a filter other than gzip and shuffle")
        size = int(np.prod(data.shape, dtype=object)) * data.dtype.itemsize
        chunk = int(np.prod(data.chunks, dtype=object)) * data.dtype.itemsize if data.chunks else 0
        self._unpack_left -= size
        if self._unpack_left < 0 or chunk > max(size, UNPACK_BASE):
            raise self.error(f"{name} claims {max(size, chunk)} bytes, more than a file of {self._size} bytes may hold")
        chunks = int(np.prod([-(-n // c) for n, c in zip(data.shape, data.chunks or (), strict=False)], dtype=object))
        if chunks * CHUNK_ENTRY_MIN > self._size:  # HDF5 searches for each, also for those that were never written
            raise self.error(f"{name} claims {chunks} chunks, more than a file of {self._size} bytes may hold")
        if filters and size:
            self._check_chunks(name, data, chunk, deflated=h5py.h5z.FILTER_DEFLATE in filters)

    def _check_chunks(self, name: str, data: h5py.Dataset, chunk: int, *, deflated: bool) -> None:
        """Refuse chunks that claim more bytes than the file has, or inflate to more than their size: HDF5 would
        allocate and inflate all of that."""
        for i in range(data.id.get_num_chunks()):
            info = data.id.get_chunk_info(i)
            if info.size > self._size:
                raise self.error(f"{name} claims a chunk of {info.size} bytes in a file of {self._size}")
            if not deflated:
                continue
            mask, raw = data.id.read_direct_chunk(info.chunk_offset)
            stored = zlib.decompressobj()
            # Four bytes more: the checksum that Fletcher's filter may append.
            if mask == 0 and len(stored.decompress(raw, chunk + 5)) > chunk + 4:
                raise self.error(f"{name} holds a chunk that inflates to more than its {chunk} bytes")

    def number(self, name: str, key: str) -> float:
        """A scalar attribute of the group or dataset `name` ("" is the root)."""
        value = self._attribute(name, key)
        if np.ndim(value) != 0 or not isinstance(value, (int, float, np.integer, np.floating)):
            raise self.error(f"attribute {key!r} of {name or 'the file'} is not a number")
        return float(value)

    def vector(self, name: str, key: str) -> np.ndarray:
        """An attribute of three numbers, float64."""
        value = np.asarray(self._attribute(name, key))
        if value.shape != (3,) or value.dtype.kind not in "fiu":
            raise self.error(f"attribute {key!r} of {name} is not three numbers")
        return value.astype(np.float64)

    def text(self, name: str, key: str) -> str:
        """A text attribute."""
        value = self._attribute(name, key)
        if isinstance(value, bytes):
            value = value.decode("utf-8")
        if not isinstance(value, str) or len(value) > TEXT_MAX:
            raise self.error(
                f"attribute {key!r} of {name or 'the file'} is not a text of at most {TEXT_MAX} characters"
            )
        return str(value)

    def json(self, name: str, key: str):
        """The value of a text attribute that holds JSON."""
        try:
            return json.loads(self.text(name, key))
        except (ValueError, RecursionError) as e:
            raise self.error(f"attribute {key!r} of {name or 'the file'} is not JSON") from e

    def _attribute(self, name: str, key: str):
        node = self._find(name) if name else self._file
        if node is None or key not in node.attrs:
            raise self.error(f"missing attribute {key!r} of {name or 'the file'}")
        stored = node.attrs.get_id(key)
        plain = stored.dtype.kind in "fiu" or h5py.check_string_dtype(stored.dtype) is not None
        text = h5py.check_string_dtype(stored.dtype)
        shapes = ((),) if text else ((), (3,))
        if stored.shape not in shapes or not plain or stored.dtype.itemsize > TEXT_MAX:
            raise self.error(f"attribute {key!r} of {name or 'the file'} is neither a number nor a text")
        if text and text.length is None:
            with open(self.path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                self._check_heaps(data)
                self._check_text_length(data, key)
        return node.attrs[key]

    def _check_text_length(self, data: mmap.mmap, key: str) -> None:
        """Check the length that an attribute claims for its text of variable length: HDF5 allocates and clears that.

        The file is searched for attribute messages of this name, since HDF5 does not tell where they are. One is its
        version [1 byte], flags [1], the sizes of name, datatype and dataspace [2 each], from version 3 on a character
        set [1]; then these three, padded to 8 bytes in version 1; then the text's length [4] and place in a heap.
        """
        name, found = key.encode() + b"\0", 0
        at = data.find(name)
        while at >= 0:
            for header, versions in ((8, (1, 2)), (9, (3,))):
                if at < header or data[at - header] not in versions:
                    continue
                sizes = np.frombuffer(data[at - header + 2 : at - header + 8], "<u2").astype(int)
                if sizes[0] != len(name):
                    continue
                start = at + int((-(-sizes // 8) * 8 if data[at - header] == 1 else sizes).sum())
                found += 1
                if int.from_bytes(data[start : start + 4], "little") > min(self._size, 4 * TEXT_MAX):
                    raise self.error(
                        f"attribute {key!r} claims a text longer than the file or than {TEXT_MAX} characters"
                    )
            at = data.find(name, at + 1)
        if not found:
            raise self.error(f"attribute {key!r} is stored in a form that this program does not read")

    def _check_heaps(self, data: mmap.mmap) -> None:
        """Walk the heaps that hold texts of variable length: HDF5 loops forever in a damaged one.

        A heap is "GCOL", 1, 3 zeros and its size [8 bytes]; then objects of an index [2], 6 bytes, a
        size [8] and the padded data. Index 0 is what is left free, its header included.
        """
        at = data.find(HEAP)
        while at >= 0:
            end = at + int.from_bytes(data[at + 8 : at + 16], "little")
            at += 16
            while at + 16 <= end <= len(data):
                size = int.from_bytes(data[at + 8 : at + 16], "little")
                if data[at : at + 2] == b"\0\0":
                    at += size
                    break
                at += 16 + -(-size // 8) * 8
            if not end - 16 < at <= end:
                raise self.error("a heap of texts is damaged")
            at = data.find(HEAP, at)


@contextmanager
def open_hdf5(path: Path) -> Iterator[Hdf5Reader]:
    """Open a file for reading. Any exception that h5py raises on a damaged file becomes BadInput."""
    size = file_size(path)
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield Hdf5Reader(path, file, size)
    except (OSError, KeyError, ValueError, RuntimeError, TypeError, OverflowError, MemoryError, zlib.error) as e:
        reason = " ".join(str(e).split())[:120]
        raise BadInput(f"{path}: not a readable HDF5 file ({reason or type(e).__name__})") from e


@contextmanager
def new_hdf5(path: Path, libver: tuple[str, str] | None = None) -> Iterator[h5py.File]:
    """A new HDF5 file, kept in memory and written to `path` at the end.

    HDF5 itself, after it fails to write to a full disk, tries again whenever the process ends, and crashes it.
    """
    image = io.BytesIO()  # of HDF5's own driver for files in memory a copy would be needed
    with h5py.File(image, "w", libver=libver) as file:
        yield file
    # Released at once: an exception keeps its frames, and Python 3.13 complains of views that outlive the image.
    with image.getbuffer() as content, open(path, "wb") as out:
        out.write(content)


def write_dataset(file: h5py.File, name: str, values: np.ndarray, dtype) -> None:
    """Write a compressed dataset."""
    file.create_dataset(name, data=np.asarray(values, dtype), compression="gzip", shuffle=True)
