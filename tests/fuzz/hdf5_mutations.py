"""Mutations of HDF5 files by way of the library: types, shapes, values, attributes, links, chunks that are bombs."""

import contextlib
import functools
import json
import re
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from tests.fuzz.mutations import (
    HARD_FLOATS,
    HARD_INTEGERS,
    Files,
    Mutation,
    hard_value,
    json_text,
    mutated_json,
    mutated_value,
)

FLOAT_TYPES, INTEGER_TYPES = ("f2", "f4", "f8", ">f4"), ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", ">i4")
SIZE_MAX = 1_000_000  # numbers of a dataset that is changed
Change = Callable[[np.random.Generator, h5py.File], None]


@functools.cache
def zeros_chunk(size: int) -> bytes:
    """A deflated chunk of zeros."""
    return zlib.compress(bytes(size), 9)


def names(file: h5py.File, kind: type) -> list[str]:
    """Names of the groups or datasets, sorted, without those that claim a size which was never written."""
    found: list[str] = []

    def take(name: str, node) -> None:
        if isinstance(node, kind) and not (isinstance(node, h5py.Dataset) and (node.size or 0) > SIZE_MAX):
            found.append(name)

    file.visititems(take)
    return sorted(found)


def any_of(rng: np.random.Generator, options):
    """One of the options, as it is."""
    return options[int(rng.integers(len(options)))]


def put(file: h5py.File, name: str, values, **options) -> None:
    """Replace a dataset, unless h5py cannot write such values; its attributes stay."""
    attributes = dict(file[name].attrs)
    try:
        data = file.create_dataset(f"{name}~", data=values, **options)
    except (TypeError, OSError):  # texts or references that were mutated before
        file.pop(f"{name}~", None)
        return
    del file[name]
    file.move(f"{name}~", name)
    for key, value in attributes.items():
        data.attrs[key] = value


def change_values(rng: np.random.Generator, file: h5py.File) -> None:
    """Some numbers at an extreme: one, some, or all."""
    data = file[any_of(rng, names(file, h5py.Dataset))]
    values = data[()]
    if not isinstance(values, np.ndarray) or values.size == 0 or values.dtype.kind not in "fiu":
        return
    flat = values.reshape(-1)
    where = rng.random(flat.size) < any_of(rng, (0.0, 0.1, 1.0))
    where[rng.integers(flat.size)] = True
    with np.errstate(all="ignore"):
        if values.dtype.kind == "f":
            flat[where] = np.array(rng.choice(HARD_FLOATS, int(where.sum()))).astype(values.dtype)
        else:
            bits = 8 * values.dtype.itemsize
            wild = [any_of(rng, (*HARD_INTEGERS, len(flat), len(flat) - 1)) % (1 << bits) for _ in range(where.sum())]
            flat[where] = np.array(wild, np.uint64).astype(f"u{values.dtype.itemsize}").view(f"i{bits // 8}")
    data[...] = flat.reshape(values.shape)


def change_type(rng: np.random.Generator, file: h5py.File) -> None:
    """The same numbers as another type, or no numbers at all."""
    name = any_of(rng, names(file, h5py.Dataset))
    values = file[name][()]
    if isinstance(values, h5py.Empty):  # mutated before
        return
    kind = any_of(rng, (*FLOAT_TYPES, *INTEGER_TYPES, "bool", "c8", "S3", "text", "compound", "reference", "void", "g"))
    with np.errstate(all="ignore"):
        match kind:
            case "text":
                put(file, name, np.full(np.shape(values), "x", object), dtype=h5py.string_dtype())
            case "compound":
                put(file, name, np.zeros(np.shape(values), [("a", "f4"), ("b", "i4")]))
            case "reference":
                put(file, name, np.full(np.shape(values), file.ref, object), dtype=h5py.ref_dtype)
            case "void":
                put(file, name, np.zeros(np.shape(values), "V7"))
            case _ if np.asarray(values).dtype.kind in "fiub":
                put(file, name, np.asarray(values).astype(kind))


def change_shape(rng: np.random.Generator, file: h5py.File) -> None:
    """Rows that are lost or doubled, a dimension more or less, nothing at all."""
    name = any_of(rng, names(file, h5py.Dataset))
    values = np.asarray(file[name][()])
    rows = len(values) if values.ndim else 0
    match rng.integers(8):
        case 0:
            put(file, name, values[:0] if values.ndim else values[None])
        case 1:
            put(file, name, values[: rng.integers(rows + 1)] if rows else values)
        case 2:
            put(file, name, np.concatenate([values] * int(any_of(rng, (2, 100)))) if rows else values)
        case 3:
            put(file, name, values[None])
        case 4:
            put(file, name, values.ravel())
        case 5:
            put(file, name, values.T)
        case 6:
            put(file, name, h5py.Empty(any_of(rng, ("f4", "i4"))))
        case _:
            put(file, name, values.ravel()[:1].sum() if values.dtype.kind in "fiu" else 1.0)


def claim(rng: np.random.Generator, file: h5py.File) -> None:
    """A dataset that claims more than it holds: chunks that were never written, or that inflate."""
    name = any_of(rng, names(file, h5py.Dataset))
    shape, kind = file[name].shape or (), file[name].dtype
    attributes = dict(file[name].attrs)
    if not shape or 0 in shape[1:] or kind.kind not in "fiu":
        return
    rows = int(any_of(rng, (10**5, 10**7, 10**9, 10**12, 2**62)))
    del file[name]
    chunk = (int(any_of(rng, (1, 1024, 1 << 20))), *(max(n, 1) for n in shape[1:]))
    data = file.create_dataset(name, (max(rows, chunk[0]), *shape[1:]), kind, chunks=chunk, compression="gzip")
    for key, value in attributes.items():
        data.attrs[key] = value
    size = int(np.prod(chunk)) * kind.itemsize * int(any_of(rng, (1, 1, 64)))
    for k in range(int(any_of(rng, (0, 1, 50)))):
        if (k + 1) * chunk[0] <= data.shape[0] and size <= 1 << 28:
            with contextlib.suppress(OSError):  # HDF5 refuses some that its chunk cache holds
                data.id.write_direct_chunk((k * chunk[0], *(0 for _ in shape[1:])), zeros_chunk(size))


def change_node(rng: np.random.Generator, file: h5py.File) -> None:
    """A group or dataset that is lost, a link, a copy of another, or the other of the two."""
    every = names(file, (h5py.Dataset, h5py.Group))
    name, other = any_of(rng, every), any_of(rng, every)
    kind = rng.integers(8)
    is_group = isinstance(file[name], h5py.Group)
    if kind == 1 and not (name.startswith(f"{other}/") or other.startswith(f"{name}/") or name == other):
        del file[name]
        file.copy(file[other], name)
        return
    if kind == 2:
        if is_group and "round" not in file[name]:
            file[name]["round"] = file["/"]
        return
    del file[name]
    match kind:
        case 3:
            file[name] = h5py.SoftLink(any_of(rng, (f"/{other}", f"/{name}", "/", "nowhere")))
        case 4:
            file[name] = h5py.ExternalLink(any_of(rng, ("/etc/passwd", "other.h5", file.filename)), any_of(rng, every))
        case 5 if is_group:
            file[name] = np.arange(3.0)
        case 5:
            file.create_group(name)
        case 6:
            file[name] = np.dtype("f4")
        case 7:
            file[name] = any_of(rng, (1.5, "text", np.zeros((0, 3)), np.zeros((3, 0, 4), "i4")))


def change_attribute(rng: np.random.Generator, file: h5py.File) -> None:
    """An attribute that is lost, of another type or shape, or at an extreme; JSON in it with other values."""
    owners = [name for name in ("/", *names(file, (h5py.Dataset, h5py.Group))) if len(file[name].attrs)]
    node = file[any_of(rng, owners)].attrs
    key = any_of(rng, sorted(node))
    value = node[key]
    if isinstance(value, str) and rng.random() < 0.6:
        try:
            changed = json_text(mutated_value(rng, json.loads(value))).decode()
        except ValueError:
            changed = any_of(rng, ("", "x", value * 2, value.upper()))
        del node[key]
        if "\0" not in changed and len(changed) < 50_000:
            node[key] = changed
        return
    del node[key]
    texts = ("", "x", b"\xff\xfe", "y" * 40_000, [b"a", b"b"], np.array(["a", "b", "c"], h5py.string_dtype()))
    arrays = (np.zeros(3), np.full(3, np.nan), np.zeros((3, 3)), np.zeros(4, "i4"), [True, False, True], np.zeros(7000))
    odd = (h5py.Empty("f4"), np.void(b"abc"), True, 1 + 2j, file.ref, np.float16(2), *texts, *arrays)
    new = any_of(rng, (*odd, *HARD_FLOATS, *HARD_INTEGERS, None))
    if isinstance(new, int) and not isinstance(new, bool):
        new = np.array(new % (1 << 64), np.uint64) if new >= 0 else np.array(new, np.int64)
    if new is not None:
        node[key] = new


def change_json_lines(rng: np.random.Generator, file: h5py.File) -> None:
    """JSON lines in a dataset of bytes, one with other values in it."""
    texts = [n for n in names(file, h5py.Dataset) if n.endswith("/text") and file[n].dtype.kind in "iuf"]
    if not texts:
        return change_attribute(rng, file)
    name = any_of(rng, texts)
    with np.errstate(invalid="ignore"):
        lines = bytes(np.asarray(file[name][()] if file[name].shape else 0).astype(np.uint8)).splitlines()
    if not lines:
        lines = [json_text(hard_value(rng))]
    k = int(rng.integers(len(lines)))
    lines[k] = mutated_json(rng, lines[k])
    put(file, name, np.frombuffer(b"\n".join(lines) + b"\n", np.uint8))
    return None


CHANGES: list[Change] = [change_values, change_type, change_shape, claim, change_node, change_attribute]
CHANGES += [change_attribute, change_values, change_json_lines]


def claim_text(rng: np.random.Generator, files: Files) -> Files:
    """Another length of a text attribute: the four bytes before the address of a heap."""
    ((name, data),) = files.items()
    heaps = [match.start() for match in re.finditer(rb"GCOL\x01\0{3}", data)]
    places = [match.start() for heap in heaps for match in re.finditer(re.escape(heap.to_bytes(8, "little")), data)]
    if not places:
        return files
    end = any_of(rng, places)
    length = int(any_of(rng, (0, 1, 255, 1 << 20, 1 << 31, (1 << 32) - 16, (1 << 32) - 1)))
    return {name: data[: end - 4] + length.to_bytes(4, "little") + data[end:]}


def inside_hdf5(folder: Path) -> Mutation:
    """One to three changes of an HDF5 file that remains sound as such; it is made in `folder`."""

    def mutation(rng: np.random.Generator, files: Files) -> Files:
        ((name, data),) = files.items()
        path = folder / "mutated.h5"
        path.write_bytes(data)
        with h5py.File(path, "r+") as file:
            for _ in range(rng.choice([1, 2, 3], p=[0.7, 0.2, 0.1])):
                if names(file, h5py.Dataset):
                    with contextlib.suppress(UnicodeEncodeError):  # a text that was none before
                        any_of(rng, CHANGES)(rng, file)
        found = {name: path.read_bytes()}
        path.unlink()
        return found

    return mutation
