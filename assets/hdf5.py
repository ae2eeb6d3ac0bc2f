"""Reading of HDF5 files from untrusted sources: nothing is followed out of the file and every size is bounded.

HDF5 can point to other files (external and soft links, external and virtual storage), load plug-in
filters, hold pickled objects, and claim sizes that its bytes do not back. All of that is refused
before a dataset is read.
"""

from __future__ import annotations

import io
import mmap
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import h5py
import numpy as np

from assets.file_access import UNPACK_BASE, file_size, unpack_bound
from core.errors import BadInput
from core.typed import from_json

T = TypeVar("T")
Sides = tuple[int | None, ...]  # of a dataset; None stands for any length
Span = tuple[float, float]  # bounds of numbers, both allowed
FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
ATTRIBUTE, CONTINUATION = 0x0C, 0x10  # kinds of messages in the header of an object
BLOCKS_MAX, BLOCK_SIZE_MAX = 16, 1 << 20  # of such a header; [bytes]
CHUNK_ENTRY_MIN = 8  # [bytes] of a stored chunk's entry in the index: its address
TEXT_MAX = 1 << 20  # [bytes] of a text
ATTRIBUTE_TEXT_MAX = 60_000  # [bytes]; HDF5 takes less than 64 KiB with all that is around it


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

    def array(self, name: str, kind: str, shape: Sides) -> np.ndarray:
        """A dataset of numbers as it is stored. `kind` is "f" or "iu"."""
        data = self._find(name)
        if not isinstance(data, h5py.Dataset):
            raise self.error(f"missing dataset {name!r}")
        if data.dtype.kind not in kind or data.dtype.itemsize > 8:
            expected = "floating-point numbers" if kind == "f" else "integers"
            raise self.error(f"{name} holds {data.dtype}, expected {expected}")
        got = data.shape
        if got is None or len(got) != len(shape) or any(s not in (None, g) for s, g in zip(shape, got, strict=True)):
            expected = ", ".join("*" if s is None else str(s) for s in shape)
            raise self.error(f"{name} has shape {got}, expected ({expected})")
        self._bound(name, data)
        return data[()]

    def floats(self, name: str, shape: Sides, dtype=np.float32, *, within: Span | None = None) -> np.ndarray:
        """A dataset of floating-point numbers, all of them `within` two bounds; None: not checked to be finite."""
        with np.errstate(over="ignore", invalid="ignore"):  # an overflow becomes infinite
            values = self.array(name, "f", shape).astype(dtype, copy=False)
        if within is not None and not ((values >= within[0]) & (values <= within[1])).all():  # NaN compares false
            raise self.error(f"{name} holds values out of range")
        return values

    def indices(self, name: str, shape: Sides, dtype=np.int32, *, low: int = 0, high: int | None = None) -> np.ndarray:
        """A dataset of integers from `low` to `high`; None: to the largest of `dtype`."""
        values = self.array(name, "iu", shape)
        if values.size and (values.min() < low or values.max() > (np.iinfo(dtype).max if high is None else high)):
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
        return float(self._attribute(name, key, (), "a number"))

    def vector(self, name: str, key: str) -> np.ndarray:
        """An attribute of three numbers, float64."""
        return self._attribute(name, key, (3,), "three numbers").astype(np.float64)

    def _attribute(self, name: str, key: str, shape: tuple[int, ...], expected: str):
        """An attribute of numbers."""
        node = self._find(name) if name else self._file
        if node is None or key not in node.attrs:
            raise self.error(f"missing attribute {key!r} of {name or 'the file'}")
        stored = node.attrs.get_id(key)
        if stored.shape != shape or stored.dtype.kind not in "fiu":
            raise self.error(f"attribute {key!r} of {name or 'the file'} is not {expected}")
        return node.attrs[key]

    def text(self, name: str, key: str, default: str | None = None) -> str:
        """A text of the group or dataset `name` ("" is the root), as `write_text` writes it, or an attribute.

        `default` stands for one that is not there; without it that is an error.
        """
        where = f"{key!r} of {name or 'the file'}"
        path = f"{name}/{key}" if name else key
        if default is not None and not self.has(path) and not self.has_attribute(name, key):
            return default
        if self.has(path):
            content = self.array(path, "iu", (None,)).astype(np.uint8).tobytes()
        else:
            content = self._text_attribute(name, key, where)
        try:
            if len(content) <= TEXT_MAX:
                return content.decode()
        except UnicodeDecodeError:
            pass
        raise self.error(f"{where} is not a text of at most {TEXT_MAX} bytes")

    def json(self, name: str, key: str, kind: type[T], default: str | None = None) -> T:
        """The value of this type (core/typed.py) that a text holds as JSON."""
        return from_json(kind, self.text(name, key, default), f"{self.path}: {key}")

    def check_format(self, name: str, what: str, newest: int) -> int:
        """The version of a file of this format. Raises BadInput if it is another one, or newer than is known."""
        if self.text("", "format") != name:
            raise self.error(f"is not {what} of VR-GS")
        version = self.number("", "version")
        if version not in range(1, newest + 1):
            raise self.error(f"is {what} of version {version:g}; this program knows 1 to {newest}")
        return int(version)

    def _text_attribute(self, name: str, key: str, where: str) -> bytes:
        """The content of an attribute with a text of fixed length, or of variable length as in older files."""
        node = self._find(name) if name else self._file
        if node is None or key not in node.attrs:
            raise self.error(f"missing {where}")
        stored = node.attrs.get_id(key)
        kind = h5py.check_string_dtype(stored.dtype)
        if stored.shape != () or kind is None or stored.dtype.itemsize > TEXT_MAX:
            raise self.error(f"{where} is not a text of at most {TEXT_MAX} bytes")
        if kind.length is not None:
            return bytes(node.attrs[key])
        base, address = self._file.userblock_size, h5py.h5o.get_info(node.id).addr
        with open(self.path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            content = variable_text(data, base, base + address, key.encode())
        if content is None:
            raise self.error(f"{where} is damaged, or stored in a form that this program does not read")
        return content


def variable_text(data: mmap.mmap, base: int, address: int, key: bytes) -> bytes | None:
    """Content of an attribute with a text of variable length; None if it is damaged or elsewhere.

    Files of this program had these until 2026. HDF5 2.0 cannot be trusted with one: it allocates and clears the length
    that the attribute claims, up to 4 GiB, and loops for ever in a damaged heap. `address` is that of the object's
    header in the file, whose addresses count from `base`.
    """
    for start, size in header_messages(data, base, address):
        version = data[start]
        head = start + {1: 8, 2: 8, 3: 9}.get(version, size)
        sizes = [integer(data, start + at, 2) for at in (2, 4, 6)]  # of name, datatype and dataspace
        if data[head : head + sizes[0]] == key + b"\0":
            value = head + sum(-(-n // 8) * 8 if version == 1 else n for n in sizes)
            length, heap, index = integer(data, value, 4), integer(data, value + 4, 8), integer(data, value + 12, 4)
            return b"" if length == 0 else heap_object(data, base + heap, index, length)
    return None


def header_messages(data: mmap.mmap, base: int, address: int) -> Iterator[tuple[int, int]]:
    """Start and size of the attributes in an object's header, of versions 1 and 2 of the format."""
    latest = data[address : address + 4] == b"OHDR"
    if latest:
        flags = integer(data, address + 5, 1)
        first, width = address + 6 + 16 * (flags >> 5 & 1) + 4 * (flags >> 4 & 1), 1 << (flags & 3)
        blocks = [(first + width, integer(data, first, width))]
    else:
        flags, blocks = 0, [(address + 16, integer(data, address + 8, 4))]
    prefix = 4 + 2 * (flags >> 2 & 1) if latest else 8  # [bytes] before a message
    kind_width = 1 if latest else 2  # [bytes]
    for at, size in blocks:
        end = min(at + min(size, BLOCK_SIZE_MAX), len(data))
        while at + prefix <= end:
            kind, size = integer(data, at, kind_width), integer(data, at + kind_width, 2)
            at += prefix
            if kind == ATTRIBUTE and at < len(data):
                yield at, size
            elif kind == CONTINUATION and len(blocks) < BLOCKS_MAX:
                there, length = base + integer(data, at, 8), integer(data, at + 8, 8)
                blocks.append((there + 4, length - 8) if latest else (there, length))  # "OCHK", and a checksum behind
            at += size


def heap_object(data: mmap.mmap, heap: int, index: int, length: int) -> bytes | None:
    """An object of a global heap; None if it is not there, or not of this length."""
    at, end = heap + 16, min(heap + integer(data, heap + 8, 8), len(data))
    while data[heap : heap + 4] == b"GCOL" and at < end and integer(data, at, 2):
        size = integer(data, at + 8, 8)
        if integer(data, at, 2) == index:
            return data[at + 16 : at + 16 + size] if size == length else None
        at += 16 + -(-size // 8) * 8
    return None


def integer(data: mmap.mmap, at: int, size: int) -> int:
    """An unsigned integer of the file; what lies beyond its end counts as zeros."""
    return int.from_bytes(data[at : at + size], "little")


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


def runs(counts: np.ndarray) -> list[slice]:
    """Slices of a column that holds runs of these lengths, one after the other."""
    ends = np.cumsum(counts, dtype=np.int64)
    return [slice(int(end - count), int(end)) for end, count in zip(ends, counts, strict=True)]


def write_dataset(file: h5py.File, name: str, values: np.ndarray, dtype) -> None:
    """Write a compressed dataset."""
    file.create_dataset(name, data=np.asarray(values, dtype), compression="gzip", shuffle=True)


def write_text(node: h5py.Group, key: str, text: str) -> None:
    """Write a text as an attribute of fixed length, or, where that is too long for HDF5, as a dataset of bytes."""
    content = text.encode()
    if len(content) < ATTRIBUTE_TEXT_MAX:
        node.attrs[key] = np.array(content or b"\0", "S")
    else:
        node.create_dataset(key, data=np.frombuffer(content, np.uint8))
