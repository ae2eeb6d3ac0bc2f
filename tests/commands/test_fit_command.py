"""`vrgs.py fit`: a beam's material from its motion by theory, the report, and what is refused."""

import numpy as np
import pytest

from assets.asset import Asset, Cage
from commands.parser import parse
from core.errors import BadInput
from core.material import Material
from core.tetmesh import boundary_surface
from tests.support.samples import random_gaussians, tet_bar

LENGTH, SIDE, YOUNG, DENSITY, DAMPING = 0.24, 0.03, 2.5e4, 250.0, 1.5
ROOT = 1.875104
TIMES = np.arange(36) / 60
RNG = np.random.default_rng(0)
REST = RNG.uniform([0.3, 0, 0], 1, (16, 3)) * [LENGTH, SIDE, SIDE]


def swinging(amplitude=0.008, noise=1e-4):
    """Markers on a cantilever that swings in its first mode without gravity: Euler and Bernoulli, plane sections.

    w^2 = 1.8751^4 E I / (rho A L^4); the energy dies out at DAMPING, so the amplitude at half of it.
    """
    k = ROOT / LENGTH
    s = (np.cosh(ROOT) + np.cos(ROOT)) / (np.sinh(ROOT) + np.sin(ROOT))
    x, y = REST[:, 0], REST[:, 1] - SIDE / 2
    shape = (np.cosh(k * x) - np.cos(k * x) - s * (np.sinh(k * x) - np.sin(k * x))) / 2
    slope = k * (np.sinh(k * x) + np.sin(k * x) - s * (np.cosh(k * x) - np.cos(k * x))) / 2
    w = ROOT**2 * np.sqrt(YOUNG * SIDE**2 / 12 / DENSITY) / LENGTH**2
    a = amplitude * np.exp(-DAMPING / 2 * TIMES) * np.cos(w * TIMES)
    moved = np.stack([-y * slope, shape, 0 * x], 1)
    return REST + a[:, None, None] * moved + noise * RNG.normal(size=(len(TIMES), len(x), 3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An asset whose material is five times too stiff and not damped as the beam is, and tracks."""
    path = tmp_path_factory.mktemp("fit")
    x, tets = tet_bar((14, 3, 3), (LENGTH, SIDE, SIDE))
    cage = Cage(x, tets.astype(np.int32), boundary_surface(tets))
    Asset(random_gaussians(RNG, 20), cage, material=Material(5 * YOUNG, 0.3, DENSITY, damping=4.0)).save(
        path / "beam.h5"
    )
    held = np.array([[-1, -1, -1], [1e-6, 1, 1.0]])
    np.savez(path / "p.npz", times=TIMES, points=swinging(), rest=REST, held=held, gravity=np.zeros(3))
    np.savez(path / "still.npz", times=TIMES, points=swinging(0.0), rest=REST, held=held, gravity=np.zeros(3))
    return path


def run(words: str) -> None:
    command, options = parse(words.split())
    command(options)


@pytest.mark.long
def test_a_beams_material_is_found_from_the_formula_of_its_motion(ti_cpu, folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    run(f"fit {folder}/beam.h5 --from-trajectory {folder}/p.npz --out {tmp_path}/fitted.h5 --report {tmp_path}/r.html")
    said = capsys.readouterr()
    found = {line[:16].strip(): line[16:] for line in said.out.splitlines()}
    value, low, high = (float(w.strip("()")) for w in found["young"].replace("to ", "").split()[:3])
    assert abs(value / YOUNG - 1) < 0.15 and low < YOUNG < high < 2 * low
    value, low, high = (float(w.strip("()")) for w in found["damping"].replace("to ", "").split()[:3])
    assert abs(value / DAMPING - 1) < 0.25 and low < DAMPING < high
    assert found["young / density"] and "motion shows only young / density" in said.out and "scan" in said.err
    fitted = Asset.load(tmp_path / "fitted.h5").material
    assert 0.4 * YOUNG < fitted.young < 1.05 * YOUNG and fitted.density == DENSITY  # as this coarse cage needs it
    page = (tmp_path / "r.html").read_text()
    assert page.count("<svg") == 4 and "90%" in page and "nan" not in page
    assert not list((tmp_path / "cache").rglob("*.npz"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("{f}/beam.h5 --from-trajectory {f}/still.npz --out {t}/o.h5", "nothing deforms: markers move by"),
        ("{f}/beam.h5 --from-trajectory {f}/none.npz --out {t}/o.h5", "no such file|No such file"),
        ("{f}/beam.h5 --from-trajectory {f}/p.npz --out {t}/o.ply", "an asset's name ends in .h5"),
        ("{f}/beam.h5 --from-trajectory {f}/p.npz --out {t}/o.h5 --report {t}/r.pdf", "a report's name ends in .html"),
        ("{f}/none.h5 --from-trajectory {f}/p.npz --out {t}/o.h5", "none.h5"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(ti_cpu, folder, tmp_path, words, said):
    with pytest.raises(BadInput, match=said) as e:
        run("fit " + words.format(f=folder, t=tmp_path))
    assert "\n" not in str(e.value) and not list(tmp_path.iterdir())
