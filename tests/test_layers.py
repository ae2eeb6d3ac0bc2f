"""Architecture: the import order of the packages, and unique module names."""

import ast
import re
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {
    "core": set(),
    "assets": {"core"},
    "scenes": {"core", "assets"},
    "sim": {"core", "assets"},
    "render": {"core", "assets"},
    "display": {"core", "assets", "scenes", "sim", "render"},
    "prepare": {"core", "assets", "render"},
    "studio": {"core", "assets", "scenes", "sim", "render", "prepare", "display"},
    "commands": {"core", "assets", "scenes", "sim", "render", "display", "prepare", "bench"},
    "bench": {"core", "assets", "scenes", "sim", "render", "display", "prepare"},
}

SIM_PACKAGES = ("elastic", "contact", "rigid", "hands")  # none imports one that stands after it
# Modules above all four; the other modules of sim/ stand below them
SIM_TOP = {"contacts", "kinematic_targets", "recovery", "sleeping", "solver"}


BUDGETS = {  # lines; a new capability may raise one on purpose, and says why
    "core": 2_920, "assets": 5_136, "scenes": 2_344, "sim": 11_050, "render": 3_867, "prepare": 15_543,
    "display": 13_886, "commands": 4_705, "bench": 3_500, "installer": 147, "tests": 37_726,
}  # fmt: skip
MOST_FILES = 314  # of the product


def product_files() -> list[Path]:
    return [path for package in MAY_IMPORT for path in sorted((ROOT / package).rglob("*.py"))]


@pytest.mark.parametrize("folder", BUDGETS)
def test_a_folder_keeps_within_its_budget(folder):
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / folder).rglob("*.py"))
    assert lines <= BUDGETS[folder]


def test_the_product_keeps_within_its_number_of_files():
    folders = [folder for folder in BUDGETS if folder != "tests"]
    assert 1 + sum(len(list((ROOT / folder).rglob("*.py"))) for folder in folders) <= MOST_FILES


def test_only_the_commands_that_measure_import_bench():
    files = [path for path in product_files() if path.parent.name == "commands" and "bench" in imported_packages(path)]
    assert [path.name for path in files] == ["measuring.py"]


def is_for_types(node: ast.AST) -> bool:
    """True for `if TYPE_CHECKING:`, whose imports are of types alone."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def test_no_modules_import_each_other_in_a_circle():
    paths = product_files()
    names = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in paths}
    graph = {}
    for name, path in names.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        typing = {n for branch in ast.walk(tree) if is_for_types(branch) for n in ast.walk(branch)}
        nodes = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n not in typing]
        found = {n.module for n in nodes} | {f"{n.module}.{alias.name}" for n in nodes for alias in n.names}
        graph[name] = found & set(names) - {name}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


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
    files = sorted(path for path in (ROOT / package).rglob("*.py") if path.parent != ROOT / "studio" / "tests")
    assert files, f"{package}/ holds no modules"
    ours = set(MAY_IMPORT) | {"vrgs", "tests"}
    for path in files:
        wrong = (imported_packages(path) & ours) - MAY_IMPORT[package] - {package}
        assert not wrong, f"{path.relative_to(ROOT)} imports {sorted(wrong)}"


def test_one_module_reaches_into_taichis_inside():
    """`taichi.math` is not counted: forks have it too."""
    inside = re.compile(r"\btaichi\.(?!math\b)|\bti\.(lang|graph|_lib|_snode)\b")
    found = [path for path in product_files() if inside.search(path.read_text(encoding="utf-8"))]
    assert [path.relative_to(ROOT).as_posix() for path in found] == ["core/runtime.py"]


@pytest.mark.parametrize("package", SIM_PACKAGES)
def test_the_parts_of_sim_import_only_those_before_them(package):
    above = SIM_TOP | set(SIM_PACKAGES[SIM_PACKAGES.index(package) + 1 :])
    for path in sorted((ROOT / "sim" / package).rglob("*.py")):
        nodes = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.ImportFrom)]
        wrong = [n.module for n in nodes if n.module.startswith("sim.") and n.module.split(".")[1] in above]
        assert not wrong, f"{path.relative_to(ROOT)} imports {wrong}"


def test_each_module_name_stands_once():
    names = Counter(path.stem for path in product_files() if path.stem != "__init__")
    assert [name for name, count in names.items() if count > 1] == []


def test_no_two_module_names_are_taken_for_each_other():
    """Such as quantisation and quantization, which differ by one letter."""
    told_apart = [("capture_room", "captured_room"), ("prepare", "prepared")]  # commands, and what they have made
    names = sorted({path.stem for path in product_files() if len(path.stem) > 6})
    alike = [(a, b) for k, a in enumerate(names) for b in names[k + 1 :] if letters_apart(a, b) <= 1]
    assert alike == told_apart


def letters_apart(a: str, b: str) -> int:
    """Letters that must be changed, added or removed to make one of the other (Levenshtein)."""
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        last, row[0] = row[0], i
        for j, y in enumerate(b, 1):
            last, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, last + (x != y))
    return row[-1]
