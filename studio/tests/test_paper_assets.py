"""`python -m studio --detail paper`: each demo's set of assets adds up to the paper's sizes, is kept and is found."""

import numpy as np
import pytest

from assets.asset import Asset
from assets.library import find_asset, search_first
from core.errors import BadInput
from core.material import Material
from core.vocabulary import Body
from scenes import paper_demos, registry
from scenes.paper_demos import PAPER_DEMOS, PaperDemo, paper_demo_of, use_paper_assets
from scenes.scene import Scene
from studio import catalogue, paper_assets
from studio.__main__ import main
from studio.paper_assets import Part, asset_sizes, detail_of, parts_of
from studio.ring import torus_cage
from tests.support.samples import some_gaussians

DEMO = PaperDemo("toss", "ring_toss", 5_000, 3_000, 10, 38)
OWN = {"dining_room": 400, "ring_red": 100, "bottle": 50}  # Gaussians of the stand-ins as shipped
RING = Material.named("silicone")


def stand_in(name: str, rng, detail, report) -> Asset:
    """A model that misses its number of Gaussians by 7 %."""
    count = round(1.07 * OWN[name] * detail.gaussians)
    cage = torus_cage(detail.cage_vertices(270)) if name.startswith("ring") else None
    return Asset(some_gaussians(count, 0), cage, provenance={"name": name})


@pytest.fixture
def stage(tmp_path, monkeypatch):
    """Stand-ins of three assets as shipped, a scene of them, and a demo that is this scene."""
    shipped = tmp_path / "shipped"
    shipped.mkdir()
    for name in OWN:
        stand_in(name, None, catalogue.SHIPPED, None).save(shipped / f"{name}.h5")
    rings = [Body("ring_red", RING, (0.2 * k, 1.0, 0.0)) for k in range(2)]
    bodies = [Body("dining_room"), *rings, Body("bottle", RING, kind="rigid")]
    scene = Scene(bodies, light=None, eye=(0, 1, 1), target=(0, 1, 0))
    monkeypatch.setattr("assets.library.SHIPPED_FOLDER", shipped)
    monkeypatch.setattr(registry, "load", lambda name, **options: scene)
    monkeypatch.setattr(paper_demos, "PAPER_DEMOS", (DEMO,))
    monkeypatch.setattr(catalogue, "MODELS", {name: (f"{__name__}:stand_in", name) for name in OWN})
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    search_first(None)
    yield tmp_path
    monkeypatch.undo()
    search_first(None)


def test_parts_are_counted_and_ordered(stage):
    assert parts_of(registry.load("toss")) == [
        Part("ring_red", 2, 107, 270, True),
        Part("bottle", 1, 54, 0, False),
        Part("dining_room", 1, 428, 0, False),
    ]


def test_details_share_what_is_left():
    soft, room = Part("cat", 3, 100, 50, True), Part("room", 1, 700, 0, False)
    detail = detail_of(soft, [soft, room], 10_000, 600)
    assert detail.gaussians == 10.0 and detail.vertices == 200 and detail.rays == pytest.approx(10**-0.5)
    assert detail_of(room, [room], 8_400, 0).gaussians == 12.0
    with pytest.raises(BadInput, match="room: the other assets have more"):
        detail_of(room, [room], -5, 0)


def test_a_demo_is_built_at_the_paper_s_sizes_and_found(ti_cpu, stage, capsys):
    assert main(["--detail", "paper", "toss", "--arch", "cpu"]) == 0
    said = capsys.readouterr().out
    folder = stage / "cache" / "paper" / "toss"
    assert {p.name for p in folder.iterdir()} == {f"{name}.h5" for name in OWN}
    use_paper_assets(DEMO)
    assert find_asset("ring_red").parent == folder
    counts = {name: asset_sizes(name) for name in OWN}
    gaussians = 2 * counts["ring_red"][0] + counts["bottle"][0] + counts["dining_room"][0]
    assert abs(gaussians / DEMO.gaussians - 1) < 0.06 and f"{gaussians:,} Gaussians" in said
    assert abs(2 * counts["ring_red"][1] / DEMO.vertices - 1) < 0.02
    ring = Asset.load(folder / "ring_red.h5")
    assert ring.provenance["detail"][1] == 1500
    search_first(None)
    assert find_asset("ring_red").parent == stage / "shipped"


def test_what_is_there_is_kept_unless_forced(ti_cpu, stage, capsys):
    words = ["--detail", "paper", "--out", str(stage / "out"), "--arch", "cpu"]
    assert main(words) == 0
    room = stage / "out" / "toss" / "dining_room.h5"
    Asset(some_gaussians(9, 0)).save(room)
    capsys.readouterr()
    assert main(words) == 0
    assert capsys.readouterr().out.count("is there already") == 3 and len(Asset.load(room).gaussians) == 9
    assert main([*words, "--force"]) == 0
    assert len(Asset.load(room).gaussians) > 1000


def test_missing_assets_and_wrong_names_are_told_in_one_line(ti_cpu, stage, capsys, monkeypatch):
    with pytest.raises(BadInput, match=r"ring_red\.h5|dining_room\.h5") as error:
        use_paper_assets(DEMO)
    assert "studio --detail paper toss" in str(error.value)
    assert find_asset("ring_red").parent == stage / "shipped"  # as before
    assert main(["--detail", "paper", "tos", "--arch", "cpu"]) == 2
    assert "tos: no such demo; there are toss" in capsys.readouterr().err
    monkeypatch.setattr(paper_assets, "parts_of", lambda scene: [Part("mine.h5", 1, 10, 0, False)])
    assert main(["--detail", "paper", "toss", "--arch", "cpu"]) == 2
    assert "mine.h5: no model makes it" in capsys.readouterr().err


def test_rough_assets_do_not_replace_the_shipped_ones(capsys):
    assert main(["ring_red", "--detail", "rough", "--arch", "cpu"]) == 2
    assert "needs --out" in capsys.readouterr().err


def test_the_table_holds_the_paper_s_nine_demos():
    assert len(PAPER_DEMOS) == 9 and len({demo.name for demo in PAPER_DEMOS}) == 9
    assert sum(demo.gaussians for demo in PAPER_DEMOS) == 13_255_000
    assert sum(demo.vertices for demo in PAPER_DEMOS) == 198_753
    assert np.median([demo.fps for demo in PAPER_DEMOS]) == 41


def test_a_scene_with_options_is_a_demo():
    assert paper_demo_of("ring_toss", {}).name == "ring_toss"
    assert paper_demo_of("manipulation", {}).name == "fox"
    assert paper_demo_of("manipulation", {"animal": "horse"}).name == "horse"
    with pytest.raises(BadInput, match="sandbox"):
        paper_demo_of("sandbox", {})
