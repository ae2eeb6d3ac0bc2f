"""A digest of the program's own source that makes a result: the result is stale once that source has changed.

No version number has to be remembered: the modules that a module imports, at any depth, are found in its source.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]  # the binary holds the sources too: Taichi compiles kernels from them
LAYERS = ("core", "assets", "render", "prepare")  # that make results; those above show them


def source_digest(module: str, root: Path = ROOT) -> str:
    """Digest of the source of a module, "prepare.train.trainer", and of all of ours that it imports from LAYERS.

    Raises FileNotFoundError if there is no such module.
    """
    found, left = {}, [module]
    while left:
        name = left.pop()
        if name not in found:
            path = file_of(name, root)
            if path is None:
                raise FileNotFoundError(f"{name} under {root}")
            found[name] = path.read_bytes()
            left += [n for n in imported(found[name]) if n.split(".")[0] in LAYERS and file_of(n, root) is not None]
    digest = hashlib.sha256()
    for name, source in sorted(found.items()):
        digest.update(f"{name}\0{len(source)}\0".encode() + source)
    return digest.hexdigest()


def file_of(name: str, root: Path) -> Path | None:
    """The source file of a module or package; None if the name is something else, as of a function in a module."""
    path = root / name.replace(".", "/")
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)


def imported(source: bytes) -> Iterator[str]:
    """Names that a source imports, with those of what it takes from them: some of these are modules."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
