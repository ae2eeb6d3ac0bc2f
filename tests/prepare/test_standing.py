"""A prepared body starts as it rests: turned by the few degrees that a file or a cage leans."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from assets.asset import Asset
from assets.library import SHIPPED_FOLDER
from prepare.cage.level_set import ComponentSolid
from prepare.standing import stood_up


def leaning(name: str, degrees: float) -> tuple[Asset, ComponentSolid]:
    """A shipped body that leans sideways, and its distance grid as a solid."""
    asset = Asset.load(SHIPPED_FOLDER / f"{name}.h5").transformed(
        Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    )
    inside = asset.sdf.values < 0
    return asset, ComponentSolid(inside & (np.indices(inside.shape)[0] % 2 == 0), inside, asset.sdf)


def test_a_leaning_body_is_set_upright():
    """Half of the solid's cells are shell, as before; its distances stay those of the cage."""
    bear, (asset, solid) = Asset.load(SHIPPED_FOLDER / "bear.h5"), leaning("bear", 8.0)
    upright, (turned,) = stood_up(asset, [solid])
    assert upright.provenance["stood_up"] == pytest.approx(8.0, abs=1.0) and "reoriented" in asset.provenance
    turn = Rotation.align_vectors(*(b.cage.vertices - b.cage.vertices.mean(0) for b in (upright, bear)))[0]
    assert turn.magnitude() < np.radians(0.5) and upright.cage.vertices[:, 1].min() == pytest.approx(0.0, abs=1e-6)
    assert turned.solid.sum() == pytest.approx(solid.solid.sum(), rel=0.05)
    assert turned.shell.sum() == pytest.approx(solid.shell.sum(), rel=0.1)
    assert (turned.distance.values[turned.solid] < turned.distance.spacing).all()
    assert turned.distance.values.shape == turned.solid.shape


@pytest.mark.parametrize("degrees", [0.2, 40.0])
def test_what_stands_or_falls_stays_as_it_is(degrees):
    asset, solid = leaning("bear", degrees)
    assert stood_up(asset, [solid]) == (asset, [solid])
