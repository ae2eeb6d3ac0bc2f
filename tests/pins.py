"""Every pinned package has a wheel for each Python and platform that README.md names: python -m tests.pins

`make nightly` runs it; it asks the package index, and downloads nothing twice.
"""

import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
GLIBC = (5, 12, 17, 24, 26, 27, 28, 31, 34, 35)  # of the manylinux tags; pip takes each as it is written
PLATFORMS = {  # the tags of its wheels, and what markers of requirements may ask for
    "Linux": ([f"manylinux_2_{k}_x86_64" for k in GLIBC] + ["manylinux2014_x86_64"], "x86_64"),
    "Windows": (["win_amd64"], "AMD64"),
    "Darwin": ([f"macosx_{k}_0_{cpu}" for k in (11, 12, 13, 14) for cpu in ("arm64", "universal2")], "arm64"),
}


def pins() -> list[Requirement]:
    """All pinned requirements of the program, its tests and its binary, each once."""
    files = [ROOT / f"requirements{part}.txt" for part in ("", "-dev", "-binary")]
    lines = {line.partition("#")[0].strip() for file in files for line in file.read_text().splitlines()}
    return [Requirement(line) for line in sorted(lines) if line and not line.startswith("-r")]


def is_missing(case: tuple[Requirement, str, str]) -> bool:
    """True if the index has no wheel of a pin for a Python on a platform."""
    pin, python, system = case
    tags, machine = PLATFORMS[system]
    where = {"python_version": python, "platform_system": system, "platform_machine": machine}
    if pin.marker and not pin.marker.evaluate(where):
        return False
    with tempfile.TemporaryDirectory() as folder:
        words = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--quiet",
            "--no-deps",
            "--only-binary=:all:",
            "--dest",
            folder,
        ]
        words += ["--python-version", python, "--implementation", "cp", f"{pin.name}{pin.specifier}"]
        words += [word for tag in tags for word in ("--platform", tag)]
        return subprocess.run(words, capture_output=True, check=False).returncode != 0


def main() -> int:
    """Print the pins without a wheel; the exit status is 1 if there is one."""
    cases = list(product(pins(), PYTHONS, PLATFORMS))
    with ThreadPoolExecutor(4) as pool:
        missing = [case for case, lacks in zip(cases, pool.map(is_missing, cases), strict=True) if lacks]
    for pin, python, system in missing:
        print(f"{pin.name}{pin.specifier} has no wheel for Python {python} on {system}")
    print(f"{len(cases)} wheels asked for, {len(missing)} missing")
    return bool(missing)


if __name__ == "__main__":
    sys.exit(main())
