"""Mutations of files: of their bytes, of numbers in text, of JSON, of archives.

A file to be read is a dict of its files by name, mostly one. Each mutation takes a generator and such a dict, and
returns another; all randomness comes from the generator, so that a case can be repeated.
"""

import functools
import gzip
import io
import json
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

Files = dict[str, bytes]
Mutation = Callable[[np.random.Generator, Files], Files]

HARD_FLOATS = (np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, 1e-310, 3.4e38, 1e308, -1e30, 65504.0, 1e-8)
HARD_INTEGERS = (0, 1, -1, 127, 128, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, -(2**63), 10**7)
HARD_TEXTS = ("nan", "inf", "-1", "0", "1e400", "-1e-400", "9" * 30, "9" * 5000, "0x10", "", "٣", "1_0", "+7", "1.5")
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
HEADER = 4096  # [bytes] in which numbers of a binary file's text are searched
DEEP = "@deep@"  # stands for lists in lists, deeper than a parser may recurse
SIZE_MAX = 16 << 20  # [bytes] of a mutated file
BOMB_BYTES = 128 << 20  # more than files of this size may unpack to (assets/file_access.py)


def saved(folder: Path, name: str, save: Callable[[Path], object]) -> Files:
    """The file that `save` writes."""
    path = folder / name
    save(path)
    data = path.read_bytes()
    path.unlink()
    return {name: data}


def one_file(mutate: Callable[[np.random.Generator, bytes], bytes]) -> Mutation:
    """The mutation of one of the files."""

    def mutation(rng: np.random.Generator, files: Files) -> Files:
        name = list(files)[rng.integers(len(files))]
        return files | {name: mutate(rng, files[name])}

    return mutation


def place(rng: np.random.Generator, length: int) -> int:
    """A place in a file, more often near its beginning, where headers are."""
    return int(length * rng.random() ** rng.integers(1, 5))


def flip_bits(rng: np.random.Generator, data: bytes) -> bytes:
    """A few bits."""
    found = bytearray(data)
    for _ in range(rng.integers(1, 9)):
        if found:
            found[place(rng, len(found))] ^= 1 << rng.integers(8)
    return bytes(found)


def change_byte(rng: np.random.Generator, data: bytes) -> bytes:
    """One byte, anywhere."""
    at = int(rng.integers(len(data) + 1))
    return data[:at] + rng.bytes(1) + data[at + 1 :]


def truncate(rng: np.random.Generator, data: bytes) -> bytes:
    """An end that is missing."""
    return data[: rng.integers(0, len(data) + 1)]


def extend(rng: np.random.Generator, data: bytes) -> bytes:
    """Bytes, or the file itself, behind its end."""
    return data + [bytes(1 << rng.integers(16)), rng.bytes(1 << rng.integers(12)), data][rng.integers(3)]


def rearrange(rng: np.random.Generator, data: bytes) -> bytes:
    """A chunk that is doubled, lost, filled, or overwritten by another."""
    a, b = sorted((place(rng, len(data)), place(rng, len(data))))
    chunk = data[a:b]
    match rng.integers(5):
        case 0:
            return data[:b] + chunk * int(rng.integers(1, 4)) + data[b:]
        case 1:
            return data[:a] + data[b:]
        case 2:
            return data[:a] + bytes([rng.choice([0, 255, 32])]) * len(chunk) + data[b:]
        case 3:
            return data[:a] + rng.bytes(len(chunk)) + data[b:]
        case _:
            return data[:a] + data[len(data) - len(chunk) :] + data[b:]


def hard_field(rng: np.random.Generator, data: bytes) -> bytes:
    """One to three fields of 1 to 8 bytes at an extreme: a count, an offset, a NaN, a denormal."""
    for _ in range(rng.integers(1, 4)):
        if rng.random() < 0.5:
            size = int(rng.choice([1, 2, 4, 8]))
            value = HARD_INTEGERS[rng.integers(len(HARD_INTEGERS))] % (1 << 8 * size)
            field = value.to_bytes(size, "little" if rng.random() < 0.8 else "big")
        else:
            with np.errstate(over="ignore", under="ignore"):
                field = np.array(rng.choice(HARD_FLOATS)).astype(rng.choice(["<f2", "<f4", ">f4", "<f8"])).tobytes()
        at = place(rng, len(data))
        at -= at % len(field) if rng.random() < 0.7 else 0
        data = (data[:at] + field + data[at + len(field) :])[: max(len(data), 1)]
    return data


def hard_number(rng: np.random.Generator, data: bytes) -> bytes:
    """A number in text, of a header or of the whole file, at an extreme."""
    found = list(NUMBER.finditer(data, 0, HEADER if b"\0" in data[: 4 * HEADER] else len(data)))
    if not found:
        return flip_bits(rng, data)
    match, text = found[rng.integers(len(found))], HARD_TEXTS[rng.integers(len(HARD_TEXTS))]
    return data[: match.start()] + text.encode() + data[match.end() :]


def rearrange_lines(rng: np.random.Generator, data: bytes) -> bytes:
    """Lines that are doubled, lost, swapped or very long."""
    lines = data.split(b"\n")
    i, j = rng.integers(len(lines), size=2)
    match rng.integers(4):
        case 0:
            lines.insert(i, lines[j])
        case 1:
            del lines[i]
        case 2:
            lines[i], lines[j] = lines[j], lines[i]
        case _:
            lines[i] = lines[i] * int(rng.choice([2, 5000]))
    return b"\n".join(lines)


BYTES: list[Mutation] = [one_file(m) for m in (flip_bits, truncate, extend, rearrange, hard_field, hard_field)]
TEXT: list[Mutation] = [one_file(m) for m in (hard_number, hard_number, rearrange_lines)]


def several(mutations: list[Mutation]) -> Mutation:
    """One to three of them, one after the other."""

    def mutation(rng: np.random.Generator, files: Files) -> Files:
        for _ in range(rng.choice([1, 2, 3], p=[0.7, 0.2, 0.1])):
            files = mutations[rng.integers(len(mutations))](rng, files)
            files = {name: data[:SIZE_MAX] for name, data in files.items()}
        return files

    return mutation


# JSON


def hard_value(rng: np.random.Generator):
    """A value that a field of JSON does not expect."""
    values = [None, True, False, "", "x", "\ud800", "a\nb", "/etc/passwd", "z" * 100_000, [], {}, [[]], [None], DEEP]
    values += [*HARD_FLOATS, *HARD_INTEGERS, 10**400, 1.5, "1", {"": None}, list(range(2000)), "\0"]
    return values[rng.integers(len(values))]


def mutated_value(rng: np.random.Generator, value):
    """A JSON value with one to three places changed."""
    value = json.loads(json.dumps(value))
    for _ in range(rng.choice([1, 2, 3], p=[0.7, 0.2, 0.1])):
        parents: list = []
        _containers(value, parents)
        if not parents or rng.random() < 0.05:
            value = hard_value(rng)
            continue
        parent = parents[rng.integers(len(parents))]
        keys = list(parent) if isinstance(parent, dict) else list(range(len(parent)))
        key = keys[rng.integers(len(keys))]
        match rng.integers(6):
            case 0:
                del parent[key]
            case 1 if isinstance(parent, list):
                parent.extend(parent[key : key + 1] * int(rng.choice([1, 3, 1000])))
            case 1 if isinstance(parent, dict):
                parent[str(hard_value(rng))[:50]] = parent.pop(key)
            case 2:
                other = parents[rng.integers(len(parents))]
                parent[key] = json.loads(json.dumps(other))
            case _:
                parent[key] = hard_value(rng)
    return value


def like_value(rng: np.random.Generator, value):
    """A JSON value of valid structure: one to three of its numbers, texts and truths are others of their kind."""
    value, parents = json.loads(json.dumps({"": value})), []
    _containers(value, parents)
    places = [(p, k) for p in parents for k in (p if isinstance(p, dict) else range(len(p)))]
    leaves = [(p, k) for p, k in places if not isinstance(p[k], (dict, list))]
    for _ in range(rng.choice([1, 2, 3], p=[0.7, 0.2, 0.1])):
        parent, key = leaves[rng.integers(len(leaves))] if leaves else ({"": None}, "")
        old = parent[key]
        if isinstance(old, bool) or old is None:
            parent[key] = [True, False, None, 0.5, "x"][rng.integers(5)]
        elif isinstance(old, str):
            parent[key] = LIKE_TEXTS[rng.integers(len(LIKE_TEXTS))].replace("@", old)
        else:
            scaled = old * 10.0 ** rng.integers(-12, 13) if abs(old) < 1e200 else 1.0
            parent[key] = [scaled, -old, old + 1, 0, 10**400, -(10**400), 1e300, 1e-300, int(scaled)][rng.integers(9)]
    return value[""]


LIKE_TEXTS = ("@ ", "x@", "", "@@", "z" * 300, "é" * 200, "a/" * 3000, "../@", "/@", "con", ".", "\0", "\ud800", "a\nb")


def _containers(value, found: list) -> None:
    children = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    if len(children):
        found.append(value)
    for child in children:
        _containers(child, found)


def json_text(value) -> bytes:
    """JSON text, with what stands for deep lists replaced by them."""
    deep = "[" * 100_000 + "]" * 100_000
    text = json.dumps(value).replace(json.dumps(DEEP), deep)
    return text.encode()


def mutated_json(rng: np.random.Generator, data: bytes) -> bytes:
    """A JSON file with other values in it; flipped bits in what is none any more."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        return flip_bits(rng, data)
    return json_text((like_value if rng.random() < 0.5 else mutated_value)(rng, value))


JSON: list[Mutation] = [one_file(mutated_json)] * 6 + BYTES + TEXT


# compressed files and archives


@functools.cache
def deflated_bomb(wbits: int) -> bytes:
    """BOMB_BYTES of zeros, in a thousandth of that."""
    pack = zlib.compressobj(9, zlib.DEFLATED, wbits)
    return b"".join([*(pack.compress(bytes(1 << 20)) for _ in range(BOMB_BYTES >> 20)), pack.flush()])


def inside_gzip(rng: np.random.Generator, files: Files) -> Files:
    """The content of a gzip stream mutated, in a stream with an honest checksum; or a bomb behind a sound header."""
    ((name, data),) = files.items()
    try:
        content = gzip.decompress(data)
    except (OSError, EOFError, zlib.error):  # mutated before
        return several(BYTES)(rng, files)
    if rng.random() < 0.02:
        header = hard_field(rng, content[:16])
        return {name: gzip.compress(header, 1)[:-8] + deflated_bomb(31)[10:]}
    if rng.random() < 0.03:
        return {name: gzip.compress(content[: rng.integers(16, 40)], 1) + deflated_bomb(31)}
    ((_, content),) = several(BYTES)(rng, {name: content}).items()
    return {name: gzip.compress(content, 1)}


def entries(data: bytes) -> Files:
    """The files of a ZIP archive."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(entries: list[tuple[str, bytes]], method: int) -> bytes:
    """A ZIP archive, in which names may occur twice."""
    buffer = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", method) as archive:
        warnings.simplefilter("ignore", UserWarning)
        for name, content in entries:
            archive.writestr(name, content)
    return buffer.getvalue()


def inside_zip(inner: Mutation) -> Mutation:
    """The files of a ZIP archive mutated, lost, doubled, renamed, of another size, or a bomb; checksums are honest."""

    def mutation(rng: np.random.Generator, files: Files) -> Files:
        ((outer, data),) = files.items()
        try:
            found = entries(data)
        except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, RuntimeError, struct.error):  # mutated before
            return several(BYTES)(rng, files)
        method = int(rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED]))
        name = list(found)[rng.integers(len(found))]
        stored = list(found.items())
        match rng.integers(20):
            case 0:
                stored.remove((name, found[name]))
            case 1:
                other = str(rng.choice(["../x", "/etc/passwd", "a\\b", name.upper(), "x/" + name]))
                stored[stored.index((name, found[name]))] = (other, found[name])
            case 2:
                stored += [(name, found[name])] * int(rng.choice([1, 1000]))
            case 3:
                size = HARD_INTEGERS[rng.integers(len(HARD_INTEGERS))] % (1 << 32)
                packed, honest = zipped(stored, method), len(found[name]).to_bytes(4, "little")
                return {outer: packed.replace(honest, size.to_bytes(4, "little"))}
            case 4:
                bomb = zipped([(n, bytes(BOMB_BYTES) if n == name else c) for n, c in stored], zipfile.ZIP_DEFLATED)
                size = int(rng.choice([BOMB_BYTES, 1000]))
                return {outer: bomb.replace(BOMB_BYTES.to_bytes(4, "little"), size.to_bytes(4, "little"))}
            case _:
                stored = list(inner(rng, found).items())
        return {outer: zipped(stored, method)}

    return mutation
