"""The toy rabbit with the material that `vrgs.py fit` finds from a film of it, and that film: scenes/fitted_toy.py."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import taichi as ti

from assets.asset import Asset
from core.errors import BadInput
from studio.detail import Detail
from studio.filmed_toys import CLIPS, film_toy

PROGRAM = Path(__file__).resolve().parents[1] / "vrgs.py"


def fitted_rabbit(clip: str, rng: np.random.Generator, detail: Detail, report: Callable[[str], None]) -> Asset:
    """The shipped asset of a clip of studio/filmed_toys.py after `vrgs.py fit`; the detail is that asset's."""
    with tempfile.TemporaryDirectory() as folder:
        film_toy(clip, Path(folder), report)
        film, out = Path(folder) / clip, Path(folder) / "fitted.h5"
        words = ["fit", CLIPS[clip].asset, f"{film}.mp4", "--camera", f"{film}.camera.json", "--out", out]
        words += ["--marks", f"{film}.marks.json", "--arch", "cuda" if ti.cfg.arch == ti.cuda else "cpu"]
        done = subprocess.run([sys.executable, PROGRAM, *words], check=False)
        if done.returncode:
            raise BadInput(f"{clip}: was not fitted")
        asset = Asset.load(out)
    return replace(asset, provenance=asset.provenance | {"fitted_to": clip})
