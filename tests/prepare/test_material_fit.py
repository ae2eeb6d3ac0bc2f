"""The material of a hanging bar from its markers, where the simulator is linear elasticity by its modes, in float64."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from core.camera import look_at, perspective
from core.errors import BadInput
from core.material import Material
from core.tetmesh import box_mesh
from prepare.fit import material_fit
from prepare.fit.fit_report import lines_of, page_of
from prepare.fit.least_squares import Fitted
from prepare.fit.linear_elasticity import ElasticShape, subdivided
from prepare.fit.marker_tracks import MarkerTracks, Rig, marker_weights
from prepare.fit.material_fit import MaterialProblem, fit_material, scan_youngs
from prepare.progress import no_progress
from sim.rollouts import Candidate, Rollouts

SIZE = np.array([0.24, 0.04, 0.04])
HELD = np.array([[-1, -1, -1], [1e-6, 1, 1.0]])
TRUE = Material(2e5, 0.3, 250.0, damping=1.5)
ASSET = Material(1e6, 0.3, 250.0, damping=4.0)
GRAVITY, FRAMES = np.array([0, -9.81, 0.0]), 60


def modes_of(cage):
    """Free vertices of a held cage, squared frequencies at 1 Pa and 1 kg/m^3, modes of mass 1, and masses."""
    if not hasattr(modes_of, "kept") or modes_of.kept[0] is not cage:
        free = np.setdiff1d(np.arange(len(cage.vertices)), cage.held)
        s = ElasticShape(cage.vertices, cage.tets, cage.held, TRUE.poisson, 1)
        mass = np.repeat(s.mass[free], 3)
        squares, shapes = scipy.linalg.eigh(s.K.toarray() / np.sqrt(np.outer(mass, mass)))
        modes_of.kept = (cage, free, squares, shapes / np.sqrt(mass)[:, None], mass)
    return modes_of.kept[1:]


def roll(cage, candidates, times=np.arange(FRAMES) / 60):
    """Small motions of a held cage under gravity, exactly: each mode is a damped oscillation about its sag."""
    free, squares, shapes, mass = modes_of(cage)
    found = []
    for m, x, v in candidates:
        w2 = squares * m.young / m.density
        c = np.minimum(m.damping + m.retardation_time * w2, 1.9 * np.sqrt(w2))  # what is faster creeps back anyway
        u, du, load = (
            (shapes.T @ (mass * q[free].ravel())) for q in (x - cage.vertices, v, np.tile(GRAVITY, (len(x), 1)))
        )
        sag, w = load / w2, np.sqrt(w2 - c**2 / 4)
        a, b = u - sag, (du + c / 2 * (u - sag)) / w
        decay = np.exp(-np.outer(times, c) / 2)
        q = sag + decay * (a * np.cos(np.outer(times, w)) + b * np.sin(np.outer(times, w)))
        places = np.tile(cage.vertices, (len(times), 1, 1))
        places[:, free] += (q @ shapes.T).reshape(len(times), -1, 3)
        found.append(cage.markers(places))
    return np.stack(found, 1)


def yielding(cage, candidates):
    """The slowest mode alone, by small steps: where it is at rest follows it, beyond 0.2 m times the yield strain."""
    free, squares, shapes, mass = modes_of(cage)
    materials, x, v = zip(*candidates, strict=True)
    load = shapes[:, 0] @ (mass * np.tile(GRAVITY, len(free)))
    w2 = squares[0] * np.array([m.young / m.density for m in materials])
    most = 0.2 * np.array([m.yield_strain or np.inf for m in materials]) * np.sqrt(mass.sum() / 3)
    c = np.array([m.damping for m in materials])
    q, dq = (np.array([shapes[:, 0] @ (mass * u[free].ravel()) for u in us]) for us in (x - cage.vertices, v))
    rest, found, dt = 0 * q, [], 1 / 960
    for k in range(16 * FRAMES):
        if k % 16 == 0:
            found.append(q)
        dq = (dq + dt * (load - w2 * (q - rest))) / (1 + dt * c)
        q = q + dt * dq
        rest = np.clip(rest, q - most, q + most)
    places = np.tile(cage.vertices, (FRAMES, len(q), 1, 1))
    places[:, :, free] += (np.array(found)[..., None] * shapes[:, 0]).reshape(FRAMES, len(q), -1, 3)
    return np.moveaxis([cage.markers(p) for p in np.moveaxis(places, 1, 0)], 0, 1)


def tracks_of(material, cells, noise=2e-4, seed=0, start=0.0, roll=roll):
    """Markers on a bar that is let go at rest, by a cage of these cells; NaN where a marker is hidden."""
    rng = np.random.default_rng(seed)
    rest = rng.uniform([0.2, 0, 0], 1, (12, 3)) * SIZE
    blank = MarkerTracks(
        np.arange(FRAMES) / 60, np.zeros((FRAMES, 12, 3)), rest, HELD, np.inf, None, np.zeros((0, 4)), GRAVITY
    )
    x, tets, _ = box_mesh(SIZE, cells)
    moving = replace(
        blank, points=blank.points + rest + np.sin(7 * blank.times)[:, None, None]
    )  # only to make its cage
    cage = MaterialProblem(moving, x, tets, material, roll, "truth").cage
    points = roll(cage, [(material, cage.vertices, 0 * cage.vertices + start)])[:, 0]
    points += noise * rng.normal(size=points.shape)
    points[20:26, 3] = np.nan
    return replace(blank, points=points)


def fitted(tracks, cells=(8, 1, 1), asset=ASSET, roll=roll, **known):
    x, tets, _ = box_mesh(SIZE, cells)
    problem = MaterialProblem(tracks, x, tets, asset, roll, "clip")
    return fit_material(problem, no_progress, lambda name, make: make(), mass_known=known.get("mass_known", True))


def test_stiffness_and_damping_are_found_and_are_within_their_intervals():
    found = fitted(tracks_of(TRUE, (8, 1, 1)), mass_known=False)
    ratio, young, damping, _ = found.numbers
    names = ["young / density", "young", "damping", "yield_strain"]
    assert [n.name for n in found.numbers] == names and [n.seen for n in found.numbers] == [True, True, True, False]
    np.testing.assert_allclose(young.played, TRUE.young, rtol=0.02)  # of the same cage
    np.testing.assert_allclose(damping.played, TRUE.damping, rtol=0.1)
    assert damping.low < TRUE.damping < damping.high
    np.testing.assert_allclose(ratio.value * TRUE.density, young.value)
    assert found.material == replace(ASSET, young=young.played, damping=damping.played)
    assert found.error < 2 * np.sqrt(3) * found.noise


def test_a_yield_strain_is_found_where_the_clip_ends_deformed():
    true = replace(TRUE, yield_strain=0.05)
    found = fitted(tracks_of(true, (8, 1, 1), roll=yielding), roll=yielding)
    young, _, strain = found.numbers
    assert young.seen and strain.seen and strain.low < strain.value < strain.high < 1.5 * strain.low
    np.testing.assert_allclose([young.played, strain.played], [true.young, true.yield_strain], rtol=0.03)
    assert found.material.yield_strain == strain.played and f"{strain.value:.3g} (" in "".join(lines_of(found))


def test_the_simulators_yield_strain_is_found_from_another_integrator(ti_cpu, monkeypatch):
    """XPBD moves the truth; the fit begins with half of its Young's modulus, as the scan might give it."""
    monkeypatch.setattr(material_fit, "MOST_REFINED", 0)
    true, times = replace(TRUE, young=1e5, damping=3.0, yield_strain=0.03), np.arange(12) / 30
    x, tets, _ = box_mesh(SIZE, (4, 1, 1))
    tracks = tracks_of(TRUE, (4, 1, 1))
    weights, held = marker_weights(x, tets, tracks.rest, "truth"), np.flatnonzero(x[:, 0] < 1e-6)
    other = Rollouts(x, tets, held, 1, integrator="xpbd")
    points = other.run([Candidate(true, x, 0 * x)], times, lambda q: weights @ q[0])
    points += 2e-4 * np.random.default_rng(0).normal(size=points.shape)
    usual = Rollouts(x, tets, held, 64)

    def roll(cage, candidates):
        return usual.run([Candidate(*c) for c in candidates], times, cage.markers)

    problem = MaterialProblem(replace(tracks, times=times, points=points), x, tets, ASSET, roll, "clip")
    start = problem.prior.centre.copy()
    start[:2] = np.log([0.5 * true.young, 4.0])
    scanned = {"scores": np.ones((len(scan_youngs(problem)), 3)), "guess": start}
    keep = lambda name, make: scanned if name == "scan" else make()  # noqa: E731
    found = fit_material(problem, no_progress, keep, mass_known=True)
    for number in found.numbers:
        assert number.seen and number.low < getattr(true, number.name) < number.high < 2 * number.low
    for rollouts in (usual, other):
        rollouts.destroy()


@pytest.mark.parametrize(("asset", "kept"), [(None, None), (0.01, None), (0.5, 0.5)])
def test_what_springs_back_gets_no_yield_strain_and_loses_one_that_would_show(asset, kept):
    found = fitted(tracks_of(TRUE, (8, 1, 1), roll=yielding), asset=replace(ASSET, yield_strain=asset), roll=yielding)
    assert not found.numbers[-1].seen and found.material.yield_strain == kept
    np.testing.assert_allclose(found.material.young, TRUE.young, rtol=0.03)


def test_a_coarse_cage_is_corrected_for_its_size():
    """The truth moves by a finer cage: as it is, the coarse one would need less than nine tenths of its modulus."""
    found = fitted(tracks_of(TRUE, (24, 5, 5)), cells=(12, 2, 2))
    young = found.numbers[0]
    assert young.played < 0.9 * TRUE.young and young.low < TRUE.young < young.high
    np.testing.assert_allclose(young.value, TRUE.young, rtol=0.15)


def test_what_does_not_move_or_moves_unlike_any_material_is_refused():
    with pytest.raises(BadInput, match="clip: nothing deforms: markers move by"):
        fitted(tracks_of(replace(TRUE, young=1e9), (8, 1, 1)))
    tracks = tracks_of(TRUE, (8, 1, 1))
    shaken = np.cumsum(np.random.default_rng(1).normal(size=(FRAMES, 1, 3)), 0) * 0.01
    with pytest.raises(BadInput, match="clip: no material moves like this"):
        fitted(replace(tracks, points=tracks.points + shaken))


def test_what_the_clip_does_not_show_is_said_and_stays_as_it_was():
    """A fifth of a second in 1 mm of noise: an interval that covers a factor of 2.5 is not a number."""
    tracks = tracks_of(replace(TRUE, damping=0.1), (8, 1, 1), noise=1e-3)
    short = replace(tracks, times=tracks.times[:13], points=tracks.points[:13])
    x, tets, _ = box_mesh(SIZE, (8, 1, 1))
    problem = MaterialProblem(short, x, tets, ASSET, lambda c, q: roll(c, q, short.times), "clip")
    found = fit_material(problem, no_progress, lambda name, make: make(), mass_known=True)
    damping = found.numbers[1]
    assert not damping.seen and found.material.damping == ASSET.damping
    assert "not visible in this clip" in "\n".join(lines_of(found))
    page = page_of(found, short, "bar <1>")
    assert "not visible in this clip" in page and "bar &lt;1&gt;" in page and page.count("<svg") == 4


def test_a_candidate_that_explodes_is_not_taken_for_one_that_no_marker_contradicts():
    def exploding(cage, candidates):
        stiff = [m.young > 3 * TRUE.young for m, _, _ in candidates]
        return np.where(np.array(stiff)[:, None, None], np.nan, roll(cage, candidates))

    x, tets, _ = box_mesh(SIZE, (8, 1, 1))
    problem = MaterialProblem(tracks_of(TRUE, (8, 1, 1)), x, tets, ASSET, exploding, "clip")
    found = fit_material(problem, no_progress, lambda name, make: make(), mass_known=True)
    np.testing.assert_allclose(found.numbers[0].played, TRUE.young, rtol=0.02)


def test_a_resumed_fit_takes_what_was_kept():
    tracks, kept = tracks_of(TRUE, (8, 1, 1)), {}
    x, tets, _ = box_mesh(SIZE, (8, 1, 1))
    calls = []

    def counting(cage, candidates):
        calls.append(len(candidates))
        return roll(cage, candidates)

    def keep(name, make):
        kept[name] = kept[name] if name in kept else make()
        return kept[name]

    problem = MaterialProblem(tracks, x, tets, ASSET, counting, "clip")
    first = fit_material(problem, no_progress, keep, mass_known=True)
    calls.clear()
    again = fit_material(problem, no_progress, keep, mass_known=True)
    assert calls == [3] and again.numbers == first.numbers  # only the curves are drawn anew


def sliding(cage, candidates):
    """Candidates that slide down a slope of 3 in 5 as rigid bodies, whatever they are made of: a = g (0.6 - 0.8 mu)."""
    times, down = np.arange(FRAMES) / 60, np.array([0.8, -0.6, 0.0])
    found = []
    for m, x, v in candidates:
        way = 0.5 * 9.81 * max(0.6 - 0.8 * m.friction, 0.0) * times**2
        found.append(cage.markers(x + times[:, None, None] * v + way[:, None, None] * down))
    return np.stack(found, 1)


@pytest.mark.parametrize(("faster", "bent"), [(0.0, 0.0), (0.02, 0.0), (0.0, 2e-3)])
def test_what_slides_shows_its_friction_but_not_its_stiffness(faster, bent):
    """Something unknown makes it faster [m/s] after half a second: friction is not known better than to that.

    Or it is hit after 0.3 s and bends by 2 mm as no material explains: then what presses it is not known, and neither
    is its friction.
    """
    rng = np.random.default_rng(0)
    rest = rng.uniform(0, 1, (12, 3)) * SIZE
    x, tets, _ = box_mesh(SIZE, (8, 1, 1))
    planes = np.array([[0.6, 0.8, 0.0, 0.0]])
    blank = MarkerTracks(np.arange(FRAMES) / 60, np.zeros((FRAMES, 12, 3)), rest, None, np.inf, None, planes, GRAVITY)
    cage = MaterialProblem(replace(blank, points=blank.points + rest), x, tets, ASSET, sliding, "truth").cage
    points = sliding(cage, [(replace(TRUE, friction=0.3), x, 0 * x)])[:, 0] + 2e-4 * rng.normal(size=(FRAMES, 12, 3))
    points += faster * np.maximum(blank.times - 0.5, 0.0)[:, None, None] * [0.8, -0.6, 0.0]
    points[..., 1] += (
        bent * np.sin(40 * np.maximum(blank.times - 0.3, 0.0))[:, None] * np.cos(6 * np.pi * rest[:, 0] / SIZE[0])
    )
    problem = MaterialProblem(replace(blank, points=points), x, tets, ASSET, sliding, "clip")
    found = fit_material(problem, no_progress, lambda name, make: make(), mass_known=True)
    young, damping, friction = found.numbers
    assert not young.seen and not damping.seen and friction.seen == (bent == 0.0)
    if bent:
        assert found.material == ASSET
        return
    assert found.material == replace(ASSET, friction=friction.played)
    assert friction.low < 0.3 < friction.high and friction.high - friction.low < 0.05


def test_no_number_is_known_better_than_to_what_the_material_leaves_unexplained(monkeypatch):
    """The bar is also shaken at 5.3 Hz: at the ends of the interval it moves by at least as much as is left over."""
    monkeypatch.setattr(material_fit, "MOST_REFINED", 0)
    tracks, kept = tracks_of(TRUE, (8, 1, 1)), {}
    shaken = 1.5e-3 * np.sin(2 * np.pi * 5.3 * tracks.times)[:, None, None] * (tracks.rest[:, :1] / SIZE[0]) ** 2
    x, tets, _ = box_mesh(SIZE, (8, 1, 1))
    problem = MaterialProblem(replace(tracks, points=tracks.points + shaken * [0, 1, 0]), x, tets, ASSET, roll, "clip")
    found = fit_material(problem, no_progress, lambda n, make: kept.setdefault(n, make()), mass_known=True)
    young, theta = found.numbers[0], kept["fit"]["theta"]
    ends = np.tile(theta, (3, 1))
    ends[1:, 0] = np.log([young.low, young.high])
    places = problem.places(ends)
    moved = np.sqrt(((places[1:] - places[0]) ** 2).sum(3).mean((1, 2)))
    left = np.sqrt(found.error**2 - 3 * found.noise**2)
    assert left > found.noise
    np.testing.assert_array_less(0.9 * left, moved)


def seen_by(camera, x, wider=0.0):
    """Tracks of 12 markers in pictures with noise of 0.2 px, each taken for a point half a pixel beside it; the box of
    what is held is `wider` [px] than that."""
    rng, metres = np.random.default_rng(2), 0.5 / camera.fx
    cells = (16, 4, 4) if wider else (8, 1, 1)
    tracks = tracks_of(TRUE, cells, noise=0.0)
    seen = metres * np.stack(camera.projected(tracks.points)[:2], -1)
    seen += metres * (0.2 * rng.normal(size=seen.shape) + 0.5 * rng.normal(size=seen.shape[1:]))
    u, v, _ = camera.projected(x[x[:, 0] < 1e-6])
    held = np.array([[u.min() - 1, v.min() - 1, u.max() + 1 + wider, v.max() + 1, 0]])
    rig = Rig((camera,), np.zeros(12, int))
    return replace(tracks, points=seen, camera=rig, metres=metres, pose=np.eye(4), start=x, held=held)


def test_the_same_is_found_from_one_camera_although_markers_are_offset():
    """Seen in pictures of 480x360."""
    camera = perspective(480, 360, 0.6, look_at((0.05, 0.1, 0.5), (0.12, 0.0, 0.0)))
    tracks = seen_by(camera, box_mesh(SIZE, (8, 1, 1))[0])
    found = fitted(tracks)
    young, damping = found.numbers
    np.testing.assert_allclose(young.played, TRUE.young, rtol=0.03)
    np.testing.assert_allclose(damping.played, TRUE.damping, rtol=0.2)
    assert damping.low < TRUE.damping < damping.high and found.error < 3 * 0.3 * tracks.metres
    assert found.modelled.shape == tracks.points.shape and "In the picture" in page_of(found, tracks, "bar")


@pytest.mark.long
@pytest.mark.parametrize("borders", [0, material_fit.BORDERS])
def test_a_box_that_takes_in_more_than_what_is_held_is_made_narrower(monkeypatch, borders):
    """With 1.5 cm more of the bar in the box it would be softer; boxes that are made narrower show that it need not."""
    monkeypatch.setattr(material_fit, "BORDERS", borders)
    camera = perspective(480, 360, 0.6, look_at((0.05, 0.1, 0.5), (0.12, 0.0, 0.0)))
    (x, tets, _), kept = box_mesh(SIZE, (8, 2, 2)), {}
    problem = MaterialProblem(seen_by(camera, x, 19.0), x, tets, ASSET, roll, "clip")
    fit_material(problem, no_progress, lambda n, make: kept.setdefault(n, make()), mass_known=True)
    fit = Fitted(**{**kept["fit"], "scale": float(kept["fit"]["scale"]), "steps": int(kept["fit"]["steps"])})
    shift, spread = kept["cage"]["shift"][0], kept["cage"]["spread"][0]
    fine, whole, _ = subdivided(x, tets)
    stiffness = [
        ElasticShape(p, t, np.flatnonzero(p[:, 0] < 1e-6), TRUE.poisson, 1).stiffness[0]
        for p, t in ((x, tets), (fine, whole))
    ]
    limit = np.log(TRUE.young) + np.log(stiffness[0] / stiffness[1]) / 3  # the truth moves by the cage cut in eight
    assert (abs(fit.theta[0] + shift - limit) <= spread) == (borders > 0)


def test_a_free_body_seen_by_one_camera_sets_off_as_it_was_thrown():
    """Of how it comes nearer the pictures show little: it is not taken for fast, and not for deforming quickly."""
    camera = perspective(480, 360, 0.6, look_at((0.1, 0.1, 0.8), (0.12, 0.0, 0.0)))
    rng, times, metres = np.random.default_rng(4), np.arange(FRAMES) / 60, 0.8 / camera.fx
    x, tets, _ = box_mesh(SIZE, (8, 1, 1))
    rig, rest, thrown = Rig((camera,), np.zeros(40, int)), rng.uniform(0, 1, (40, 3)) * SIZE, np.array([0.4, 0.9, 0.0])
    bent = 0.008 * np.sin(40 * times)[:, None, None] * np.cos(2 * np.pi * rest[:, :1] / SIZE[0]) * [0, 1, 0]
    places = rest + bent + times[:, None, None] * thrown + times[:, None, None] ** 2 / 2 * GRAVITY
    seen = metres * (np.stack(camera.projected(places)[:2], -1) + 0.2 * rng.normal(size=(FRAMES, 40, 2)))
    tracks = MarkerTracks(
        times, seen, rest, None, np.inf, np.eye(4), np.zeros((0, 4)), GRAVITY, rig, metres, x.astype(float)
    )
    problem = MaterialProblem(tracks, x, tets, ASSET, roll, "clip")
    middle = problem.v0.mean(0)
    np.testing.assert_allclose(middle[:2], thrown[:2], atol=0.1)
    assert abs(middle[2]) < 0.3 and np.abs(problem.v0 - middle).max() < 0.8


def test_the_scan_begins_with_what_hardly_bears_its_own_weight():
    """Young's modulus at which a column sags by a sixth of its height: 3 rho g L."""
    x, tets, _ = box_mesh(SIZE, (8, 1, 1))
    problem = MaterialProblem(tracks_of(TRUE, (8, 1, 1)), x, tets, ASSET, roll, "clip")
    assert scan_youngs(problem).min() < 3 * ASSET.density * 9.81 * SIZE.max()
