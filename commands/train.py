"""`vrgs.py train`: Gaussians from photographs."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from assets.file_access import atomic_write, check_writable, write_json
from assets.splat_files import kind_to_write, write_gaussians
from commands import options as cli
from core.errors import BadInput
from core.report import Section, Table, html_page
from core.runtime import is_out_of_memory, running_arch, start_taichi
from prepare.room_capture.stages import Stages, file_key, source_digest
from prepare.train import train_options
from prepare.train.capture import Capture, Lens, View
from prepare.train.capture_files import checked, read_capture, read_colmap, reader_of
from prepare.train.photographs import image_size, learned_and_tested, photographs_differ
from prepare.train.structure_from_motion import (
    VIDEOS,
    find_poses,
    image_folder,
    load_pycolmap,
    photographs_in,
    sharpest_frames,
)
from prepare.train.train_options import CAPS, FAST_STEPS, STEPS

POSES_SOURCE = "prepare.train.structure_from_motion"
Say = Callable[[str], None]
NO_MASKS = Path("none")
LINE_SECONDS = 0.5  # between two progress lines of a terminal; elsewhere ten times as long
PREVIEW_SECONDS = 0.2  # [s] of training between two pictures
TEST_PICTURES = 4  # of the report


@dataclass(kw_only=True)
class TrainOptions(cli.Options):
    EXAMPLES = (
        "train fox/ --out fox.ply",
        "train fox/ --out fox.ply --steps 7000 --report fox.json",
        "train COLMAP_FOLDER --out room.spz --strategy mcmc --cap 500000",
        "train fox/ --out small.ply --steps 2000 --reduce 4        on a laptop",
        "train walk.mp4 --out garden.ply                           needs pycolmap",
        "train room/ --out room.ply --masks room/masks --split     also a splat for each object",
    )
    CONDITIONS = (
        cli.Condition(("--fresh",), lambda o: o.checkpoint_every > 0, "belongs to --checkpoint-every N"),
        cli.Condition(("--split",), lambda o: o.masks != NO_MASKS, "belongs to --masks FOLDER"),
    )

    capture: Path = cli.argument("CAPTURE", f"{cli.CAPTURES}, folder of photographs, or a video")
    out: Path = cli.option("OUT", "OUT.ply, OUT.spz, OUT.splat or OUT.compressed.ply", cli.REQUIRED)
    steps: cli.Count | None = cli.option("N", f"steps (default {cli.by_device(STEPS)}; a third of that with --fast)")
    fast: bool = cli.switch("about the same quality in a third of the time: fewer steps, starting on small pictures")
    strategy: Literal["default", "mcmc"] = cli.option(
        None, "default: add Gaussians where detail is missing; mcmc: always use all of --cap", "default"
    )
    cap: cli.Count | None = cli.option("N", f"upper limit of Gaussians (default {cli.by_device(CAPS)})")
    degree: Literal[0, 1, 2, 3] = cli.option("D", "degree of the spherical harmonics, 0 to 3 (default 3)", 3)
    antialias: bool = cli.switch("train for anti-aliased rendering (Mip-Splatting)")
    exposure: bool = cli.switch("also estimate exposure and colour balance of each photograph")
    refine_poses: bool = cli.switch("also correct the poses, by fractions of a degree")
    sort: cli.Sort = cli.option(None, "blending order (default radial; pixel, along each ray, is slower)", "radial")
    reduce: cli.Count = cli.reduce_option("the photographs")
    masks: Path | None = cli.option(
        "FOLDER", "masks to learn objects from, one colour each; none: ignore them (default: CAPTURE/masks)"
    )
    split: bool = cli.switch("also write a splat of each object and of the background, beside OUT")
    test_every: int = cli.option("N", "hold out every Nth photograph for testing; 0: none (default 8)", 8)
    report: Path | None = cli.option("R.json", "write the results as JSON, and a page with pictures beside it")
    checkpoint_every: int = cli.option("N", "steps between checkpoints, to resume from; 0: none (default 1000)", 1000)
    fresh: bool = cli.switch("ignore a checkpoint and start over")
    preview: bool = cli.switch("show the Gaussians in a window during training")
    seed: int = cli.seed_option()
    arch: cli.Arch | None = cli.arch_option()


def train(options: TrainOptions, capture: Capture | None = None) -> None:
    """Train, test, and write the Gaussians; `capture` is that of the options if it has been read. Raises BadInput."""
    from prepare.segment.object_ids import identified

    kind_to_write(options.out)
    for file in filter(None, (options.out, options.report)):
        check_writable(file)
    if options.checkpoint_every < 0:
        raise BadInput("--checkpoint-every is 0 or more")
    if options.preview:
        from display.window.gl_window import has_display

        if not has_display():
            raise BadInput("--preview: no display to open a window on")
    capture, masks = _with_masks(options, (capture or posed_capture(options)).upright())
    total = len(capture.views)
    train, test = learned_and_tested(
        capture,
        options.reduce,
        options.test_every,
        masks.ids if masks else None,
        progress=lambda count: _tell(f"photographs {count}/{total}", end=count == total),
    )
    if capture.test and test:
        print(f"{len(test)} photographs are held out, as the capture says", file=sys.stderr)
    start_taichi(options.arch)
    print(_photographs(train), file=sys.stderr)
    if options.test_every and not test:
        print(f"no photograph is held out for testing: fewer than {options.test_every} (--test-every)", file=sys.stderr)
    with _lowering(train, options):
        trainer, about, progress = _trained(options, capture, train, masks.names if masks else [])
        seconds = time.perf_counter() - progress.begin
        leave_out_unneeded(trainer, [p.camera for p in train])
    qualities = [trainer.quality(p) for p in test]
    gaussians = identified(trainer, train) if masks else trainer.gaussians()
    gaussians = replace(gaussians, view=capture.photographer())
    write_gaussians(options.out, gaussians, _say)
    _checkpoint(options).unlink(missing_ok=True)
    numbers = {"gaussians": len(gaussians), "seconds": seconds, "steps": trainer.done, "views": len(train)}
    numbers |= {"test_views": len(test), "options": about, "curve": progress.curve}
    line = f"{options.out}: {len(gaussians)} Gaussians, {trainer.done} steps in {seconds:.0f} s"
    if qualities:
        mean = {name: float(np.mean([asdict(q)[name] for q in qualities])) for name in asdict(qualities[0])}
        numbers["test"] = mean
        line += f"; {len(test)} held-out photographs: PSNR {mean['psnr']:.2f} dB, SSIM {mean['ssim']:.3f}"
    print(line)
    if masks:
        numbers["objects"] = _objects(options, trainer, test, gaussians)
    if options.report:
        write_report(options.report, numbers, trainer, test, qualities, masks and (masks.colors, gaussians.object_id))


def leave_out_unneeded(trainer, cameras: list) -> None:
    """Remove the Gaussians that no photograph needs."""
    from prepare.room_capture.contributions import contributions, needed

    g = trainer.gaussians()
    keep = needed(g, cameras, contributions(g, cameras))
    if keep.any():
        trainer.population.remove(~keep)
        _say(f"{(~keep).sum()} of {len(g)} Gaussians are left out: no photograph needs them")


def _trained(options: TrainOptions, capture, train: list, objects: list[str]) -> tuple:
    """The trainer after its last step, its options, and its progress."""
    trainer, about = _trainer(options, capture, train, objects)
    kept = _checkpoint(options)
    if options.checkpoint_every and kept.is_file() and not options.fresh:
        from prepare.train.trainer import read_checkpoint

        trainer.restore(read_checkpoint(kept, about, trainer.state(), len(train)))
        print(f"resuming from step {trainer.done} ({kept}; --fresh starts over)", file=sys.stderr)
    progress = _Progress(trainer, kept if options.checkpoint_every else None, options.checkpoint_every, about)
    if options.preview:
        _preview(options, capture, trainer, progress)
    while trainer.done < trainer.options.steps:
        progress.step()
    return trainer, about, progress


def _checkpoint(options: TrainOptions) -> Path:
    """Path of the checkpoint from which an interrupted training resumes."""
    return options.out.with_name(f"{options.out.name}.checkpoint.h5")


def _with_masks(options: TrainOptions, capture):
    """The capture and the masks of its objects, or None; files that --split will write are checked."""
    from prepare.segment.object_ids import BACKGROUND, masks_of, part_file

    if options.masks == NO_MASKS:
        return capture, None
    capture, masks = masks_of(capture, options.masks, _say)
    if masks is None and options.split:
        raise BadInput(f"--split: there are no masks of objects in {capture.folder / 'masks'}; give them with --masks")
    if masks is not None and options.split:
        if BACKGROUND in masks.names:
            raise BadInput(f"--split: an object may not be called {BACKGROUND!r}")
        for name in (*masks.names, BACKGROUND):
            check_writable(part_file(options.out, name))
    return capture, masks


def _objects(options: TrainOptions, trainer, test: list, gaussians) -> dict:
    """Numbers of each object, printed; with --split their splats are written."""
    from prepare.segment.object_ids import BACKGROUND, object_ious, part_file, split

    ious = object_ious(trainer, test, gaussians.object_id)
    counts = np.bincount(gaussians.object_id, minlength=len(trainer.objects) + 1)
    numbers = {name: {"gaussians": int(counts[k])} for k, name in enumerate(trainer.objects, 1)}
    for name, number in numbers.items():
        line = f"{name}: {number['gaussians']} Gaussians"
        if name in ious:
            number["iou"] = ious[name]
            line += f", IoU {ious[name]:.3f} with the masks of held-out photographs"
        print(line)
    if options.split:
        parts = split(gaussians)
        for name, part in parts.items():
            write_gaussians(part_file(options.out, name), part, lambda line: None)  # said of the whole
            print(f"{part_file(options.out, name)}: {len(part)} Gaussians")
        for name in (*numbers, BACKGROUND):
            if name not in parts:
                print(f"{name}: no Gaussians, no file")
    return numbers


def is_posed(path: Path) -> bool:
    """True for a capture with poses; False for photographs alone or a video."""
    if path.is_file():
        return path.suffix.lower() not in VIDEOS
    return not path.is_dir() or reader_of(path) is not None or not photographs_in(image_folder(path))


def posed_capture(options: TrainOptions) -> Capture:
    """The capture; for photographs or a video without poses these are found first, and kept beside the output."""
    path = options.capture
    if is_posed(path):
        return read_posed(path, _say)
    stages = Stages(options.out.with_name(f"{options.out.name}.poses"), stages_before(path))
    folder, views = photographs_of(path, stages, _say)
    return with_poses(folder, views, stages, _say, in_order=path.is_file())


def read_posed(path: Path, say: Say) -> Capture:
    """A capture with poses; a line to `say` where these do not seem to be those of its photographs. Raises BadInput."""
    capture = read_capture(path)
    if photographs_differ(capture):
        text = "are the poses of another set, or the photographs renamed?"
        say(f"warning: the photographs do not show the points' colours where the poses say: {text}")
    return capture


def stages_before(capture: Path) -> tuple[str, ...]:
    """Names of the stages that find the poses of a capture; none if it has them."""
    if is_posed(capture):
        return ()
    return ("frames", "poses") if capture.is_file() else ("poses",)


def photographs_of(path: Path, stages: Stages, say: Say) -> tuple[Path, list[View]]:
    """Folder and views of photographs without poses, or of the sharpest frames of a video. Raises BadInput.

    The lens and the pose of the views mean nothing.
    """
    load_pycolmap()
    folder = path
    if path.is_file():

        def make(into: Path) -> None:
            say(f"{sharpest_frames(path, into / 'images')} sharp frames of {path}")

        folder = stages.run("frames", {"video": file_key(path)}, make, source_digest(POSES_SOURCE))
    images, views = image_folder(folder), []
    for name in photographs_in(images):
        width, height = image_size(images / name)
        views.append(View(images / name, Lens(width, height, width, width, 0.5 * width, 0.5 * height), np.eye(4)))
    return folder, views


def with_poses(folder: Path, views: list[View], stages: Stages, say: Say, *, in_order: bool) -> Capture:
    """The capture of photographs whose poses are found now, or were in an earlier run. Raises BadInput.

    in_order  the photographs are frames of a video
    """

    def make(into: Path) -> None:
        names = [view.name for view in views]
        find_poses(views[0].image.parent, into / "sparse", names=names, in_order=in_order, progress=say)

    inputs = {"photographs": [file_key(view.image) for view in views]}
    done = stages.run("poses", inputs, make, source_digest(POSES_SOURCE))
    return checked(read_colmap(done / "sparse", folder))


def _trainer(options: TrainOptions, capture, train: list, objects: list[str]):
    """The trainer at its start, and all options that its steps depend on."""
    from prepare.segment.object_ids import check_learned
    from prepare.train.seeds import first_gaussians
    from prepare.train.trainer import Trainer

    arch = running_arch()
    steps, cap = options.steps or (FAST_STEPS if options.fast else STEPS)[arch], options.cap or CAPS[arch]
    how = train_options.TrainOptions(
        steps=steps,
        strategy=options.strategy,
        cap=cap,
        degree=options.degree,
        antialias=options.antialias,
        sort=options.sort,
        seed=options.seed,
        exposure=options.exposure,
        poses=options.refine_poses,
    )
    how = train_options.fast(how) if options.fast else how
    about = {**asdict(how), "capture": str(options.capture), "reduce": options.reduce, "test_every": options.test_every}
    if objects:
        check_learned(objects, train)
        about |= {"masks": str(options.masks), "objects": objects}
    start = first_gaussians(capture, train, degree=options.degree, cap=cap, seed=options.seed)
    if len(capture.points) == 0:
        print(f"the capture has no points: starting with {len(start)} Gaussians where cameras look", file=sys.stderr)
    return Trainer(train, start, capture.extent, how, objects), about


@contextlib.contextmanager
def _lowering(train: list, options: TrainOptions):
    """If memory runs out inside, raise BadInput that says which options to lower."""
    try:
        yield
    except (MemoryError, RuntimeError) as e:
        if not is_out_of_memory(e):
            raise
        text = f"not enough memory: {_photographs(train)}; --reduce {2 * options.reduce} needs a quarter of that,"
        raise BadInput(f"{text} and a smaller --cap limits the Gaussians") from e


def _photographs(photographs: list) -> str:
    """Number and sizes of the photographs, and the memory that they take on the device, 4 bytes a pixel."""
    sizes = {(p.camera.width, p.camera.height) for p in photographs}
    total = sum(4 * p.camera.width * p.camera.height for p in photographs)
    size = "{}x{}".format(*max(sizes, key=lambda s: s[0] * s[1]))
    shape = size if len(sizes) == 1 else f"{len(sizes)} sizes up to {size}"
    return f"{len(photographs)} photographs of {shape} take {total / 1e6:.3g} MB of device memory"


class _Progress:
    """Steps of a trainer with a progress line, a loss curve, and checkpoints every `every` steps to `kept`, or None."""

    def __init__(self, trainer, kept: Path | None, every: int, about: dict):
        self.trainer, self.curve, self.text = trainer, [], "the first step compiles"
        self._kept, self._every, self._about = kept, every, about
        self._first = trainer.done
        self.begin = self._told = self._compiled = time.perf_counter()
        self._interval = LINE_SECONDS if sys.stderr.isatty() else 10 * LINE_SECONDS

    def step(self) -> None:
        """One step of the trainer."""
        trainer, steps = self.trainer, self.trainer.options.steps
        trainer.step()
        if trainer.done == self._first + 1:
            self._compiled = time.perf_counter()
        if time.perf_counter() - self._told >= self._interval or trainer.done == steps:
            q, n = trainer.recent_loss(), trainer.population.count  # waits for the device
            loss = 0.8 * q.l1 + 0.2 * (1.0 - q.ssim)
            self.curve.append({"step": trainer.done, "loss": loss, "psnr": q.psnr, "gaussians": n})
            self.text = f"step {trainer.done}/{steps}  loss {loss:.4f}  PSNR {q.psnr:.2f} dB  {n} Gaussians"
            rate = (trainer.done - self._first - 1) / (time.perf_counter() - self._compiled)
            left = f"{(steps - trainer.done) / rate:.0f} s left" if rate else "the first step compiles the kernels"
            self.text += f"  {rate:.1f} steps/s  {left}"
            _tell(self.text, end=trainer.done == steps)
            self._told = time.perf_counter()
        if self._kept is not None and trainer.done % self._every == 0 and trainer.done < steps:
            from prepare.train.trainer import write_checkpoint

            write_checkpoint(self._kept, trainer.state(), self._about)


def _preview(options: TrainOptions, capture, trainer, progress: _Progress) -> None:
    """Show the Gaussians in a window while they are trained, until the window is closed or the training ends."""
    from display.viewed_file import BACKGROUND
    from display.viewer import TrainingWorld
    from display.window.window import Window
    from scenes.scene import Scene

    camera = capture.views[0].camera()
    fov_y = 2.0 * float(np.arctan(0.5 * camera.height / camera.fy))
    eye, target = tuple(camera.position), tuple(capture.looked_at())
    scene = Scene(bodies=[], light=None, background=BACKGROUND, eye=eye, target=target, fov_y=fov_y)

    def advance() -> str:
        end = time.perf_counter() + PREVIEW_SECONDS
        while trainer.done < trainer.options.steps and time.perf_counter() < end:
            progress.step()
        return progress.text

    with Window(scene, title=f"VR-GS: training {options.capture.name}") as window:
        options = trainer.options
        viewer = TrainingWorld(
            trainer.population.splats, scene, advance, size=window.size, sort=options.sort, antialias=options.antialias
        )
        for frame in window.frames(viewer):
            viewer.step(frame)
            window.present(viewer)
            if trainer.done >= trainer.options.steps:
                return
    print("the window was closed; training continues", file=sys.stderr)


def _tell(text: str, *, end: bool) -> None:
    """Show a progress line: on a terminal over the last one."""
    if sys.stderr.isatty():
        print(f"\r{text:<110}", end="\n" if end else "", file=sys.stderr, flush=True)
    elif end or text.startswith("step"):
        print(text, file=sys.stderr, flush=True)


def _say(text: str) -> None:
    """Show a line of its own."""
    print(text, file=sys.stderr, flush=True)


def write_report(path: Path, numbers: dict, trainer, test: list, qualities: list, objects=None) -> None:
    """Write the numbers, and a page with held-out photographs beside their renderings.

    objects  (colours of the masks (K, 3) uint8, ids of the Gaussians): also shows masks beside the Gaussians' objects
    """
    said = _perceptual(numbers, trainer, test)
    write_json(path, numbers)
    sections = []
    for k in np.linspace(0, len(test) - 1, min(TEST_PICTURES, len(test))).round().astype(int):
        q, drawn = qualities[k], trainer.picture(test[k].camera)
        pictures = {"photograph": test[k].pixels, "drawn": drawn}
        if objects is not None and test[k].objects is not None:
            colors = np.concatenate([np.zeros((1, 3), np.uint8), objects[0]])
            pictures["mask"] = np.where(test[k].mask[..., None], colors[test[k].objects], 0).astype(np.uint8)
            pictures["objects of the Gaussians"] = colors[trainer.seen_objects(test[k].camera, objects[1])]
        sections.append(Section(f"Unseen view {k + 1}", f"PSNR {q.psnr:.2f} dB, SSIM {q.ssim:.3f}", pictures))
    rows = [(str(c["step"]), f"{c['loss']:.4f}", f"{c['psnr']:.2f}", str(c["gaussians"])) for c in numbers["curve"]]
    table = Table(("step", "loss", "PSNR [dB]", "Gaussians"), rows[:: max(1, len(rows) // 40)])
    sections.append(Section("Training", "Means over the photographs since the row before.", table=table))
    if "objects" in numbers:
        found = numbers["objects"].items()
        rows = [(name, str(n["gaussians"]), f"{n['iou']:.3f}" if "iou" in n else "-") for name, n in found]
        table = Table(("object", "Gaussians", "IoU"), rows)
        text = "Intersection over union of masks and what the Gaussians show, over all held-out photographs."
        sections.append(Section("Objects", text, table=table))
    text = f"{numbers['gaussians']} Gaussians from {numbers['views']} photographs. {said}"
    with atomic_write(path.with_suffix(".html")) as beside:
        beside.write_text(html_page("Training", text, sections), encoding="utf-8")


def _perceptual(numbers: dict, trainer, test: list) -> str:
    """Add the mean LPIPS of the held-out photographs to the numbers; returns a sentence about it."""
    from prepare.train.image_loss import SIDE_MIN, lpips_distance

    if not test:
        return ""
    if min(min(p.mask.shape) for p in test) < SIDE_MIN:
        return f"LPIPS is not measured where photographs have sides below {SIDE_MIN} pixels."
    distance, why_not = lpips_distance()
    if distance is None:
        return f"{why_not}."
    found = []
    for photograph in test:
        drawn = np.where(photograph.mask[..., None], trainer.picture(photograph.camera), photograph.pixels)
        found.append(distance(drawn, photograph.pixels))
    numbers["test"]["lpips"] = float(np.mean(found))
    return f"LPIPS of held-out photographs: {numbers['test']['lpips']:.3f}."
