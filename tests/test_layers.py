"""The import order: assets <- scenes <- {sim | render} <- display <- vrgs.py, {assets, render} <- prepare."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {
    "assets": set(),
    "scenes": {"assets"},
    "sim": {"assets", "scenes"},
    "render": {"assets", "scenes"},
    "display": {"assets", "scenes", "sim", "render"},
    "prepare": {"assets", "render"},
}


def imported_packages(path: Path) -> set[str]:
    """Top-level packages that a file imports, at any depth of nesting."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_package_imports_only_the_layers_below(package):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files, f"{package}/ holds no modules"
    ours = set(MAY_IMPORT) | {"vrgs", "tests"}
    for path in files:
        wrong = (imported_packages(path) & ours) - MAY_IMPORT[package] - {package}
        assert not wrong, f"{path.relative_to(ROOT)} imports {sorted(wrong)}"
