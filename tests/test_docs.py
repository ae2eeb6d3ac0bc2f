"""The documentation mentions only files, modules and commands that exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "bench" / "NOTES.md", *sorted((ROOT / "docs").glob("*.md"))]
NOT_FILES = {"studio/NAME.py", "scenes/stack.py", "commands/text"}  # examples; an HDF5 dataset
PACKAGES = "assets|bench|commands|core|display|docs|prepare|render|scenes|sim|studio|tests"


def exists(path: Path) -> bool:
    """True for a file, or a folder that holds more than compiled modules."""
    return path.is_file() or any(p.is_file() and p.suffix != ".pyc" for p in path.rglob("*"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_mentions_exists(page):
    text = page.read_text(encoding="utf-8")
    links = [link.split("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]
    missing = [link for link in links if link and not (page.parent / link).exists()]
    paths = re.findall(rf"(?<![\w./])(?:{PACKAGES})/[\w./-]*\w", text)
    missing += [path for path in paths if path not in NOT_FILES and not exists(ROOT / path)]
    assert not missing


def test_the_readme_fits_on_two_screens():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 110
