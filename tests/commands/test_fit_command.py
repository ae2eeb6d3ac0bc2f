"""`vrgs.py fit`: a beam's material from its motion by theory, the report, and what is refused."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset, Cage
from assets.camera_file import write_cameras
from assets.file_access import write_json
from commands.fit import FilmedThing
from commands.marking import state_of
from commands.parser import parse
from core.camera import look_at, perspective
from core.errors import BadInput
from core.material import Material
from core.tetmesh import boundary_surface
from core.typed import to_plain
from prepare.fit.clip_masks import Clip, straightened
from prepare.fit.clip_tracks import Shot
from prepare.fit.marker_tracks import marker_weights
from prepare.fit.register import FoundCamera
from prepare.segment.marks import read_points
from prepare.train.capture_files import read_camera_views
from sim.rollouts import Candidate, Rollouts
from tests.support.filmed_block import (
    FPS,
    FRAMES,
    PIXELS,
    TRUE,
    camera_of,
    let_go,
    marks_of,
    speckled_block,
    stiffer,
    write_film,
)
from tests.support.painted_capture import write_capture
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


@pytest.mark.long
def test_a_yield_strain_is_found_from_a_bar_that_stays_bent(ti_cpu, tmp_path, capsys, monkeypatch):
    """XPBD bends a bar of cells half as large under its weight, and its markers have noise."""
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    true, size = Material(2e5, 0.3, DENSITY, damping=3.0, yield_strain=0.03), np.array([0.24, 0.04, 0.04])
    x, tets = tet_bar((16, 4, 4), size)
    rest, held = RNG.uniform([0.2, 0, 0], 1, (12, 3)) * size, np.array([[-1, -1, -1], [1e-6, 1, 1.0]])
    weights, times = marker_weights(x, tets, rest, "truth"), np.arange(30) / 30
    rollouts = Rollouts(x, tets, np.flatnonzero(x[:, 0] < 1e-6), 1, integrator="xpbd")
    points = rollouts.run([Candidate(true, x, 0 * x)], times, lambda q: weights @ q[0])
    points += 2e-4 * RNG.normal(size=points.shape)
    np.savez(tmp_path / "p.npz", times=times, points=points, rest=rest, held=held)
    x, tets = tet_bar((8, 2, 2), size)
    cage = Cage(x, tets.astype(np.int32), boundary_surface(tets))
    Asset(random_gaussians(RNG, 20), cage, material=Material(1e6, 0.3, DENSITY)).save(tmp_path / "bar.h5")
    run(f"fit {tmp_path}/bar.h5 --from-trajectory {tmp_path}/p.npz --out {tmp_path}/o.h5 --density {DENSITY}")
    found = {line[:16].strip(): line[16:] for line in capsys.readouterr().out.splitlines()}
    for name in ("young", "damping", "yield_strain"):
        value, low, high = (float(w.strip("()")) for w in found[name].replace("to ", "").split()[:3])
        assert abs(value / getattr(true, name) - 1) < 0.3 and low < getattr(true, name) < high < 2.5 * low
    assert 0.03 < Asset.load(tmp_path / "o.h5").material.yield_strain < 0.05  # as this coarse cage needs it


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


@pytest.fixture(scope="module")
def filmed(ti_cpu, tmp_path_factory):
    """An asset four times too stiff, and a film of it as it is held at one end and let go."""
    path = tmp_path_factory.mktemp("film")
    asset = stiffer(speckled_block(TRUE), 4.0)
    asset.save(path / "block.h5")
    write_film(path, asset, let_go(asset, np.arange(FRAMES) / FPS), camera_of())
    return path


VIDEO = "fit {f}/block.h5 {f}/clip.mp4 --camera {f}/camera.json --marks {f}/marks.json --out {t}/o.h5"


def test_a_preview_shows_where_the_thing_is_and_fits_nothing(filmed, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    run(VIDEO.format(f=filmed, t=tmp_path) + f" --preview --report {tmp_path}/r.html")
    page = (tmp_path / "r.html").read_text()
    assert page.count("<img") == 7 and "frame_0000" in page and not (tmp_path / "o.h5").exists()
    assert "scan" not in capsys.readouterr().err
    monkeypatch.setattr("prepare.fit.clip_masks.clip_masks", None)  # what was found is kept for the fit
    run(VIDEO.format(f=filmed, t=tmp_path) + f" --preview --report {tmp_path}/r.html")


def test_a_camera_that_is_found_is_written_to_be_given_again(filmed, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    write_capture(tmp_path / "c")
    words = VIDEO.replace("--camera {f}/camera.json", "--capture {t}/c") + " --preview --report {t}/r.html"
    words = words.format(f=filmed, t=tmp_path)
    with pytest.raises(BadInput, match=r"clip\.mp4: the clip shows too little of what .*/c shows"):
        run(words)
    found, lenses = FoundCamera(camera_of(), 40, 50, 0.5, 0.2, -0.02), []
    monkeypatch.setattr("prepare.fit.register.CapturedPlace.found_camera", lambda *_: found)
    of_lens = "prepare.fit.clip_masks.straightened"
    monkeypatch.setattr(of_lens, lambda *what: lenses.append(what[2]) or straightened(*what))
    run(words)
    monkeypatch.setattr("prepare.fit.register.CapturedPlace.found_camera", None)  # what was found is kept
    run(words)
    said = "camera: vertical field of view 32.00 ± 0.20 degrees, k1 -0.020; 40 of 50 points agree, to 0.50 px\nwrote "
    assert capsys.readouterr().out.count(f"{said}{tmp_path}/o.camera.json\n") == 2
    (written,) = read_camera_views(tmp_path / "o.camera.json", [tmp_path / "c.mp4"])
    np.testing.assert_allclose(written.world_to_camera, camera_of().world_to_camera)
    assert (written.lens.width, written.lens.height, written.lens.fx) == (*PIXELS, camera_of().fx)
    assert [lens.distortion[0] for lens in (*lenses, written.lens)] == [-0.02] * 3


def test_points_are_marked_where_the_clip_shows_too_little(filmed, tmp_path, monkeypatch):
    """The window has the photographs, too, and its points give the camera; left without points, the error stands."""
    write_capture(tmp_path / "c")
    shutil.copy(filmed / "marks.json", tmp_path / "m.json")
    shown, points = [], {"frame_0000": ((1.0, 2.0),), "00.png": (None, (3.0, 4.0))}

    def marked(subject, edit, title, size):
        shown.append((subject.views, subject.numbered))
        return replace(edit.state, points=points if len(shown) > 1 else {})

    def found(place, *what):
        shown.append(what)
        return FoundCamera(camera_of(), 7, 8, 0.5, 0.2)

    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("display.window.gl_window.has_display", lambda: True)
    monkeypatch.setattr("display.mark.mark_window.marked_in_window", marked)
    monkeypatch.setattr("prepare.fit.register.CapturedPlace.clicked_camera", found)
    words = f"fit {filmed}/block.h5 {filmed}/clip.mp4 --capture {tmp_path}/c --marks {tmp_path}/m.json --preview"
    words += f" --report {tmp_path}/r.html --out {tmp_path}/o.h5"
    with pytest.raises(BadInput, match="the clip shows too little of what"):
        run(words)
    run(words)
    frames = ["frame_0000", "frame_0014", "frame_0021", "frame_0027", "frame_0041"]
    assert shown[0] == shown[1] and shown[0][0][:6] == [*frames, "00.png"] and shown[0][1]
    assert shown[2][0] == {"frame_0000": [(1.0, 2.0)], "00.png": [None, (3.0, 4.0)]} and shown[2][2] == PIXELS
    assert read_points(tmp_path / "m.json") == shown[2][0] and len(shown) == 3


def test_without_marks_pictures_are_shown_to_be_marked(filmed, tmp_path, monkeypatch):
    """A window's marks, which are saved beside the video for the next time."""
    shutil.copy(filmed / "clip.mp4", tmp_path / "c.mp4")
    write_cameras(tmp_path / "camera.json", [camera_of().resized(320, 240)])
    shown, marks = [], marks_of(camera_of().resized(320, 240), let_go(speckled_block(TRUE), np.zeros(1)), (0,))

    def marked(subject, edit, title, size):
        shown.extend((subject.views, subject.size, title))
        return state_of(marks, {})

    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("commands.marking.check_window", lambda: None)
    monkeypatch.setattr("display.mark.mark_window.marked_in_window", marked)
    words = f"fit {filmed}/block.h5 {tmp_path}/c.mp4 --camera {tmp_path}/camera.json --out {tmp_path}/o.h5"
    for _ in range(2):
        run(words + f" --preview --report {tmp_path}/r.html")
    assert shown == [["frame_0000", "frame_0014", "frame_0027", "frame_0041"], (320, 240), "Mark c.mp4"]
    assert (tmp_path / "c.marks.json").is_file() and "frame_0000" in (tmp_path / "r.html").read_text()


@pytest.mark.long
def test_the_material_of_a_block_is_found_from_a_film(filmed, tmp_path, capsys, monkeypatch):
    """The truth moves by the cage that is fitted, so the file's modulus is compared, which suits that."""
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    run(VIDEO.format(f=filmed, t=tmp_path) + f" --report {tmp_path}/r.html")
    found = Asset.load(tmp_path / "o.h5").material
    np.testing.assert_allclose(found.young, TRUE.young, rtol=0.1)
    np.testing.assert_allclose(found.damping, TRUE.damping, rtol=0.3)
    page = (tmp_path / "r.html").read_text()
    assert page.count("<video") == 2 and page.count("<svg") == 4 and "nan" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("fit {f}/block.h5 --out {t}/o.h5", "give either a VIDEO or --from-trajectory"),
        (VIDEO.replace(" --camera {f}/camera.json", ""), "needs --camera CAM.json, or --capture"),
        (VIDEO.replace(" --marks {f}/marks.json", ""), "no display to mark objects on: --marks MARKS.json"),
        (VIDEO + " --preview", "--preview needs --report"),
        (VIDEO + " --plane 0 0 0 1", "the normal of a plane is zero"),
        (VIDEO + " --part 0.1 0.2", "7 pictures; at least 12"),
        (VIDEO + " --part 0 1 --part 0 1", "--part is given once or for each of 1 videos"),
        (VIDEO + " --part nan 0.2", "BEGIN is 0 or more, and before END"),
        (VIDEO + " --release 0", "is after the first picture"),
        (VIDEO.replace("clip.mp4", "none.mp4"), "none.mp4: no such file"),
        (VIDEO.replace("clip.mp4", "marks.json", 1), "cannot be read as a video"),
        (VIDEO.replace("camera.json", "wide.json"), r"clip.mp4: the image is 160x120, its camera 400x100"),
        (VIDEO.replace("camera.json", "two.json"), "two.json: holds 2 cameras, for 1 videos"),
        (VIDEO.replace("camera.json", "bent.json"), "bent.json: camera 0: k1 is not a number"),
        ("fit {f}/block.h5 --from-trajectory p.npz --part 0 1 --out {t}/o.h5", "--part belongs to a video"),
    ],
)
def test_what_is_wrong_with_a_film_is_said_in_one_line(filmed, tmp_path, words, said, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("display.window.gl_window.has_display", lambda: False)
    write_cameras(filmed / "wide.json", [camera_of().resized(400, 100)])
    write_cameras(filmed / "two.json", [camera_of()] * 2)
    write_json(filmed / "bent.json", to_plain(camera_of()) | {"k1": "much"})
    with pytest.raises(BadInput, match=said) as e:
        run(words.format(f=filmed, t=tmp_path))
    assert "\n" not in str(e.value) and not (tmp_path / "o.h5").exists()


def test_a_film_in_which_nothing_moves_is_refused(filmed, tmp_path, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    asset = stiffer(speckled_block(TRUE), 4.0)
    still = np.tile(asset.cage.vertices.astype(float), (24, 1, 1))
    write_film(tmp_path, asset, still, camera_of(), marked=(0,))
    words = VIDEO.format(f=filmed, t=tmp_path).replace(f"{filmed}/clip", f"{tmp_path}/clip")
    with pytest.raises(BadInput, match="nothing deforms: markers move by"):
        run(words.replace(f"{filmed}/marks", f"{tmp_path}/marks"))


@pytest.mark.parametrize(("release", "kept"), [(np.inf, 100), (0.5, 50)])
def test_the_clip_that_is_kept_shows_each_vertex_where_it_is(release, kept):
    """Spots at three vertices, in 200 pictures a hundredth of a second apart, of which every second one is kept."""
    x = np.random.default_rng(0).uniform(-0.1, 0.1, (9, 3)) + [0.5, 1.0, 0.0]
    camera = perspective(320, 240, 0.8, look_at((1.2, 1.2, 0.4), (0.5, 1.0, 0.0)))
    pictures, masks = np.zeros((200, 240, 320, 3), np.uint8), np.zeros((200, 240, 320), bool)
    u, v, _ = (a.astype(int) for a in camera.projected(x))
    masks[:, v.min() : v.max(), u.min() : u.max()] = True
    for k in range(3):
        pictures[:, v[k] - 1 : v[k] + 2, u[k] - 1 : u[k] + 2, k] = 255
    clip = Clip(pictures, np.arange(200) / 100, 0, "clip.mp4")
    shot = Shot(clip, masks, camera, np.zeros((0, 4)))
    thing = SimpleNamespace(shots=[shot], tracks=SimpleNamespace(release=release, planes=np.zeros((0, 4))))
    cage = SimpleNamespace(vertices=x - 1.0, held=np.arange(2))
    found = FilmedThing.fitted_clip(thing, cage, (None, x, 0 * x))
    found.check(9, "clip")
    assert len(found.times) == kept and found.times[-1] < release
    rows, columns = np.indices(found.pictures.shape[1:3]) + 0.5
    for k in range(3):
        spot = found.pictures[0, ..., k].astype(float)
        seen = np.array([(columns * spot).sum(), (rows * spot).sum()]) / spot.sum()
        assert_allclose(seen, np.ravel(found.camera.projected(found.positions[k : k + 1])[:2]), atol=0.7)
