"""Asset library: shipped and user's assets, their materials, and the cache of prepared ones."""

from dataclasses import replace

import pytest

from assets.library import animated_height, asset_material, cached_asset, default_material, find_asset
from core.errors import BadInput
from core.material import Material
from tests.assets.test_animation import some_motion
from tests.assets.test_asset import MATERIAL, some_asset


def test_the_default_material_is_the_asset_s_own_or_by_its_kind(tmp_path):
    path = str(tmp_path / "a.h5")
    some_asset().save(path)
    assert asset_material(path) == default_material(path) == MATERIAL and animated_height(path) is None
    replace(some_asset(), material=None).save(path)
    assert asset_material(path) is None and default_material(path) == Material.named("plush")
    replace(some_asset(), material=None, animation=some_motion()).save(path)
    assert default_material(path) == Material.named("flesh") and animated_height(path) == 1.0


def test_an_unknown_asset_is_answered_by_the_shipped_ones():
    assert find_asset("ring_red").is_file()
    with pytest.raises(BadInput, match=r"no such asset; shipped ones: .*ring_red"):
        find_asset("ring_green")


def test_a_prepared_file_is_kept_by_content_and_options(tmp_path, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    (tmp_path / "a.ply").write_bytes(b"one")
    first = cached_asset(tmp_path / "a.ply", {"vertices": 100})
    assert first.parent == tmp_path / "cache" and first.name.startswith("a-") and first.suffix == ".h5"
    assert cached_asset(tmp_path / "a.ply", {"vertices": 100}) == first
    assert cached_asset(tmp_path / "a.ply", {"vertices": 200}) != first
    (tmp_path / "a.ply").write_bytes(b"two")
    assert cached_asset(tmp_path / "a.ply", {"vertices": 100}) != first


@pytest.mark.parametrize("there", ["a file", "a folder of none"])
def test_without_a_cache_folder_a_line_says_so_once_and_nothing_is_kept(tmp_path, monkeypatch, capsys, there):
    """The user's VRGS_CACHE may be a file, or lie where no folder can be made."""
    (tmp_path / "a.ply").write_bytes(b"bytes of a splat")
    (tmp_path / "file").write_bytes(b"")
    folder = str(tmp_path / "file" if there == "a file" else "/proc/nowhere")
    monkeypatch.setenv("VRGS_CACHE", folder)
    first = cached_asset(tmp_path / "a.ply", {"vertices": 100})
    assert cached_asset(tmp_path / "a.ply", {"vertices": 200}).parent == first.parent
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and folder in said
    first.write_bytes(b"can be written")
