"""`vrgs.py fit`: the material of a real thing, from a video of it or from how markers on it moved."""

from __future__ import annotations

import base64
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated

import cv2
import numpy as np
import scipy.sparse as sp

from assets.asset import Asset
from assets.file_access import atomic_write, check_writable, write_json
from assets.library import default_material, find_asset
from commands import options as cli
from commands.segment import marked_photographs
from core.errors import BadInput
from core.report import Section
from core.runtime import start_taichi
from core.typed import to_plain
from display.picture import save_picture
from prepare.segment.marks import read_marks, read_points
from prepare.train.photographs import image_size

if TYPE_CHECKING:
    from assets.fitted_clip import FittedClip
    from display.drawn_body import DrawnBody
    from prepare.fit.clip_masks import Clip
    from prepare.fit.clip_tracks import Shot
    from prepare.fit.marker_tracks import MarkerTracks
    from prepare.fit.material_fit import CageOfMarkers
    from prepare.fit.register import CapturedPlace, FoundCamera
    from prepare.train.capture import View

GRAVITY = np.array([0.0, -9.81, 0.0])  # [m/s^2] of the world that a clip's camera stands in
CLIP_STEPS = ("masks", "camera", "shake", "pose", "tracks")  # of the progress, before those of a fit
STILLS = 24  # pictures of a clip whose median shows what stands still
KEPT_SIDE = 144  # [px] of the pictures that are kept in the asset
MARKED = 4  # pictures of a clip that are shown to be marked
VIDEO_ONLY = ("--camera", "--capture", "--marks", "--part", "--fps", "--plane", "--release", "--preview")
CAMERA, Angle = cli.OneOf(), Annotated[float, cli.within(1, 170, "an angle of 1 to 170 degrees")]


@dataclass(kw_only=True)
class FitOptions(cli.Options):
    EXAMPLES = (
        "fit bear.h5 clip.mp4 --camera cam.json --marks marks.json --out fitted.h5 --report fit.html",
        "fit ROOM/objects/bear.h5 clip.mp4 --capture PHOTOGRAPHS --out fitted.h5    the camera is found",
        "fit box.h5 clip.mp4 --camera c.json --marks m.json --plane 0.42 0.91 0 0 --out fitted.h5    down a board",
        "fit bear.h5 left.mp4 right.mp4 --camera both.json --out fitted.h5    two cameras, the same motion",
        "fit bear.h5 --from-trajectory points.npz --out fitted.h5 --report fit.html",
        "fit bear.h5 --from-trajectory points.npz --out fitted.h5 --density 85",
    )
    CONDITIONS = (
        cli.Condition(VIDEO_ONLY, lambda o: o.from_trajectory is None, "belongs to a video"),
        cli.Condition(("--fov",), lambda o: o.capture, "belongs to --capture"),
        cli.Condition(("--preview",), lambda o: o.report, "needs --report, which it writes"),
    )

    asset: str = cli.argument("ASSET", "a prepared asset, or a shipped one by name")
    video: list[Path] = cli.argument(
        "VIDEO",
        "one to four seconds of the thing, from a camera that stands still or is held in a hand; several show the same "
        "motion, from several cameras that begin at the same moment",
        [],
    )
    from_trajectory: Path | None = cli.option("POINTS.npz", "in place of a video: tracked markers (docs/formats.md)")
    camera: Path | None = cli.option(
        "CAM.json", "the video's camera in a world with +y up [m], as of `render`; a list of several", one_of=CAMERA
    )
    capture: Path | None = cli.option(
        "CAPTURE",
        f"find the camera by photographs of the place ({cli.CAPTURES}); the world of --plane is then the room that "
        "`capture` made of them, if ASSET is of that room, else the photographs', turned to +y up",
        one_of=CAMERA,
    )
    fov: Angle | None = cli.option("DEG", "vertical field of view of the video, where it is known [degrees]")
    marks: list[Path] = cli.option(
        "MARKS.json",
        'strokes and boxes on the thing in frame_0000 and others, boxes of "held" around what stands still, and points '
        "of the place for --capture (docs/formats.md); by default a window opens to draw them, and they are saved "
        "beside the video; one for each video",
        [],
    )
    part: list[list[float]] = cli.option(
        ("BEGIN", "END"), "the part of the video that counts [s]; once for all videos, or once each", [], repeat=True
    )
    fps: cli.Amount | None = cli.option("N", "pictures taken in a second, where the file plays slower or faster")
    plane: list[list[float]] = cli.option(
        ("X", "Y", "Z", "D"),
        "the thing stays over this plane, normal (X, Y, Z): n x >= D [m]; once each",
        [],
        repeat=True,
    )
    release: float = cli.option(
        "S", "when what is held is let go, from the first picture on [s] (default: never)", np.inf
    )
    out: Path = cli.option("FITTED.h5", "the asset with the fitted material", cli.REQUIRED)
    report: Path | None = cli.option("R.html", "page with the numbers, their intervals, curves, masks and films")
    preview: bool = cli.switch("only write the report's masks and how the thing was found; fit nothing")
    density: cli.Amount | None = cli.option(
        "RHO", "its density as weighed [kg/m^3]: motion under gravity alone shows only Young's modulus / density"
    )
    arch: cli.Arch | None = cli.arch_option()


def fit(options: FitOptions) -> None:
    """Fit, write the asset and the report, and print the numbers. Raises BadInput."""
    from prepare.fit.fit_report import lines_of, page_of
    from prepare.fit.marker_tracks import read_tracks
    from prepare.fit.material_fit import STEPS, MaterialProblem, fit_material
    from prepare.progress import Checkpoints, StepProgress

    source = check_files(options)
    path = find_asset(options.asset)
    asset = Asset.load(path)
    if asset.cage is None:
        raise BadInput(f"{options.asset}: has no cage to simulate (make one: python vrgs.py prepare)")
    material = asset.material or default_material(str(path))
    if options.density:
        material = replace(material, density=options.density)
    how, filmed = {"asset": str(path), "material": repr(material)}, None
    if not options.video:
        tracks, kept = read_tracks(options.from_trajectory), Checkpoints(source, how)
        start_taichi(options.arch)
        progress = StepProgress(STEPS)
    else:
        steps = tuple(step for step in CLIP_STEPS if options.capture or step != "camera")
        progress = StepProgress(steps if options.preview else steps + STEPS)
        filmed = FilmedThing(options, asset, progress, how)
        tracks, kept = filmed.tracks, filmed.kept
        if options.preview:
            write_page(options.report, page_of(None, tracks, Path(options.asset).stem, filmed.sections()))
            print(f"wrote {options.report}", file=sys.stderr)
            return
    simulator = Simulator(tracks)
    problem = MaterialProblem(tracks, asset.cage.vertices, asset.cage.tets, material, simulator.roll, str(source))
    found = fit_material(problem, progress, kept.step, mass_known=options.density is not None)
    clip = None if filmed is None else filmed.fitted_clip(problem.cage, found.played[0])
    replace(asset, material=found.material, clip=clip).save(options.out)
    if options.report:
        more = []
        if filmed is not None:
            whole = replace(problem.cage, weights=sp.identity(len(problem.cage.vertices), format="csr"))
            more = [*filmed.sections(), filmed.films(simulator.roll(whole, found.played))]
        write_page(options.report, page_of(found, tracks, Path(options.asset).stem, more))
    kept.clear()
    print("\n".join(lines_of(found)))
    print(f"wrote {options.out}" + (f" and {options.report}" if options.report else ""), file=sys.stderr)


def check_files(options: FitOptions) -> Path:
    """The file that is fitted, video or tracks. Raises BadInput for options that do not go together."""
    videos = options.video
    if bool(videos) == bool(options.from_trajectory):
        raise BadInput("give either a VIDEO or --from-trajectory POINTS.npz")
    if videos and not (options.camera or options.capture):
        raise BadInput(f"{videos[0]}: needs --camera CAM.json, or --capture CAPTURE to find it (docs/your_own.md)")
    if not all(0 <= begin < end for begin, end in options.part):
        raise BadInput("--part BEGIN END: BEGIN is 0 or more, and before END")
    if len(options.part) not in (0, 1, len(videos)) or len(options.marks) not in (0, len(videos)):
        raise BadInput(f"--part is given once or for each of {len(videos)} videos, and --marks names a file for each")
    if not options.release > 0:
        raise BadInput("--release S: is after the first picture")
    if options.out.suffix.lower() != ".h5":
        raise BadInput(f"{options.out}: an asset's name ends in .h5")
    if options.report and options.report.suffix.lower() != ".html":
        raise BadInput(f"{options.report}: a report's name ends in .html")
    for file in filter(None, (options.out, options.report, options.capture and camera_file(options))):
        check_writable(file)
    for file in filter(None, (*videos, options.camera, *options.marks, options.from_trajectory)):
        if not file.is_file():
            raise BadInput(f"{file}: no such file")
    return videos[0] if videos else options.from_trajectory


def camera_file(options: FitOptions) -> Path:
    """The file of a camera that is found: beside the fitted asset."""
    return options.out.with_suffix(".camera.json")


def write_page(path: Path, page: str) -> None:
    """Write a report. Raises BadInput."""
    with atomic_write(path) as beside:
        beside.write_text(page, encoding="utf-8")


def mark_clip(clip: Clip, size: tuple[int, int], path: Path, place: CapturedPlace | None) -> None:
    """Draw marks in a window, on some pictures of a clip in their size [px], and save them.

    place  whose photographs are shown, too, for points of it

    Raises BadInput without a display, Cancelled if the user leaves without saving.
    """
    names = {f"frame_{clip.first + k:04d}": k for k in range(len(clip.pictures))}
    shown = set(np.linspace(0, len(names) - 1, MARKED).round().astype(int).tolist())
    photographs = place.capture.views if place else []
    sizes = dict.fromkeys(names, size) | {v.name: image_size(v.image) for v in photographs}
    if path.is_file():
        shown |= {names[view] for view in read_marks(path, sizes).views if view in names}
    with tempfile.TemporaryDirectory() as folder:
        views = []
        for name, k in names.items():
            if k in shown:
                views.append(SimpleNamespace(name=name, image=Path(folder) / f"{name}.png"))
                save_picture(views[-1].image, cv2.resize(clip.pictures[k], size))
        subject = SimpleNamespace(views=[*views, *photographs], folder=Path(clip.where))
        marked_photographs(subject, sizes, path, numbered=place is not None)


class FilmedThing:
    """Clips of the asset: where it is in the pictures, and how those of the first compare with what was fitted."""

    def __init__(self, options: FitOptions, asset: Asset, progress, how: dict[str, str]):
        from display.drawn_body import DrawnBody
        from prepare.fit.clip_masks import clip_masks, read_clip, read_clip_marks, straightened
        from prepare.fit.clip_shake import steadied
        from prepare.fit.clip_tracks import ALIGNED_SIDE, Shot, clip_tracks
        from prepare.fit.marker_tracks import MarkerTracks, Rig
        from prepare.fit.register import CapturedPlace
        from prepare.progress import Checkpoints
        from prepare.room_capture.stages import file_key
        from prepare.train.capture_files import read_camera_views

        planes = np.array(options.plane, float).reshape(-1, 4)
        lengths = np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
        if not (np.isfinite(planes).all() and (lengths > 1e-9).all()):
            raise BadInput("--plane: the normal of a plane is zero, or a number is not finite")
        videos, count = options.video, len(options.video)
        parts = (options.part or [None]) * (count if len(options.part) < 2 else 1)
        clips: list[Clip] = [read_clip(v, p, options.fps) for v, p in zip(videos, parts, strict=True)]
        sizes, place, views = [c.filmed for c in clips], None, []
        if options.camera:
            views = read_camera_views(options.camera, videos)
            sizes = [(v.lens.width, v.lens.height) for v in views]
            views = [replace(v, lens=v.lens.resized(*c.size, c.where)) for v, c in zip(views, clips, strict=True)]
        else:
            place = CapturedPlace.of(options.capture, find_asset(options.asset))
            how["capture"] = place.key
        strokes = options.marks or [video.with_suffix(".marks.json") for video in videos]
        for clip, size, file in zip(clips, sizes, strokes, strict=True):
            if not file.is_file():
                mark_clip(clip, size, file, place)
        marks = [read_clip_marks(f, c, size) for f, c, size in zip(strokes, clips, sizes, strict=True)]
        how |= {name: repr(getattr(options, name)) for name in ("part", "fps", "plane", "release", "fov")}
        how |= {str(f): f.read_text(encoding="utf-8") for f in filter(None, (options.camera, *strokes))}
        self.kept = Checkpoints(videos[0], how | {"others": repr([file_key(v) for v in videos[1:]])})
        keep, masks = self.kept.step, []
        for k, (clip, (strokes_of, _)) in enumerate(zip(clips, marks, strict=True)):

            def cut(k=k, clip=clip, strokes_of=strokes_of) -> dict[str, np.ndarray]:
                return {"m": clip_masks(clip, strokes_of, lambda d: progress("masks", (k + d) / count))}

            masks.append(keep(f"masks_{k}", cut)["m"])
        progress("masks", 1.0)
        if place is not None:
            found = [
                self.found_view(options, place, k, *steadied(clips[k], masks[k])[:2], strokes[k], progress)
                for k in range(count)
            ]
            write_json(camera_file(options), [v for _, v in found] if count > 1 else found[0][1])
            print(f"wrote {camera_file(options)}")
            views = [view for view, _ in found]
        self.shots: list[Shot] = []
        self.shakes: list[str] = []
        for k, (view, (_, held)) in enumerate(zip(views, marks, strict=True)):
            clip, cut_out = straightened(clips[k], masks[k], view.lens)
            clip, cut_out, shake = steadied(clip, cut_out, lambda d, k=k: progress("shake", (k + d) / count))
            held = view.lens.undistort_points(held.reshape(-1, 2)).reshape(-1, 4)
            self.shots.append(Shot(clip, cut_out, view.camera(), held))
            self.shakes.append(shake if count == 1 else f"{videos[k].name}: {shake}")
        progress("shake", 1.0)
        progress.close()
        print("\n".join(self.shakes))
        start_taichi(options.arch)
        sides = [max(*side, ALIGNED_SIDE) for side in zip(*(s.clip.size for s in self.shots), strict=True)]
        self.drawn: DrawnBody = DrawnBody(asset, *sides)
        blank = MarkerTracks(None, None, None, None, options.release, None, planes / lengths, GRAVITY)
        names = ("times", "points", "rest", "pose", "metres", "start", "of", "held")

        def make() -> dict[str, np.ndarray]:
            found = clip_tracks(self.drawn.picture, asset, self.shots, blank, progress)
            held = np.zeros((0, 5)) if found.held is None else found.held
            return {**{n: np.asarray(getattr(found, n)) for n in names[:6]}, "of": found.camera.of, "held": held}

        a = keep("tracks", make)
        progress("tracks", 1.0)
        self.tracks: MarkerTracks = replace(
            blank,
            **{name: a[name] for name in ("times", "points", "rest", "pose", "start")},
            metres=float(a["metres"]),
            held=a["held"] if len(a["held"]) else None,
            camera=Rig(tuple(s.camera for s in self.shots), a["of"]),
        )

    def found_view(
        self, options, place: CapturedPlace, number: int, clip: Clip, masks: np.ndarray, strokes: Path, progress
    ) -> tuple[View, dict]:
        """The camera of a clip, found by what stands still in it or by marked points, printed; and as it is written.

        Where neither shows it and there is a display, points can be marked. Raises BadInput.
        """
        from prepare.fit.clip_masks import backdrop_of
        from prepare.train.capture import Lens, View

        def made(points: dict) -> FoundCamera:
            if points:
                return place.clicked_camera(points, clip, clip.filmed, options.fov)
            step = -(-len(masks) // STILLS)
            still, count = backdrop_of(clip.pictures[::step], masks[::step]), len(options.video)
            return place.found_camera(
                still, clip.where, options.fov, lambda d: progress("camera", (number + d) / count)
            )

        def make() -> dict[str, np.ndarray]:
            try:
                found = made(read_points(strokes))
            except BadInput as e:
                from display.window.gl_window import has_display

                if not has_display():
                    raise
                progress.close()
                print(f"{e}\nthe window is for points that the clip and photographs show", file=sys.stderr)
                mark_clip(clip, clip.filmed, strokes, place)
                if not (points := read_points(strokes)):
                    raise
                found = made(points)
            lens, line = np.array([found.camera.fx, found.k1]), np.array(found.described())
            return {"pose": found.camera.world_to_camera, "lens": lens, "line": line}

        kept, (width, height) = self.kept.step(f"camera_{number}", make), clip.size
        focal, k1 = kept["lens"].tolist()
        lens = Lens(width, height, focal, focal, 0.5 * width, 0.5 * height, (k1,))
        view = View(Path(clip.where), lens, kept["pose"])
        progress.close()
        print(str(kept["line"]))
        return view, to_plain(view.camera().resized(*clip.filmed)) | ({"k1": k1} if k1 else {})

    def sections(self) -> list[Section]:
        """Masks and tracks in some pictures, and the body as it was found in the first, for the report."""
        from prepare.fit.fit_report import mask_pictures

        self.drawn.move(self.tracks.start)
        pictures = {}
        for k, shot in enumerate(self.shots):
            pictures |= mask_pictures(shot, self.tracks, k)
            found = self.drawn.over(shot.clip.pictures[0] // 2, shot.camera)
            pictures |= {f"{Path(shot.clip.where).name}: the asset as it was found at the start": found}
        note = f"Outlined: the mask. Dots: points of the surface that are followed. {'. '.join(self.shakes)}."
        return [Section("Where it is", pictures=pictures, note=note)]

    def fitted_clip(self, cage: CageOfMarkers, played: tuple) -> FittedClip | None:
        """The first clip about the thing until it is let go of, and how the thing sets off: of a candidate `played`."""
        from assets.fitted_clip import PICTURES_MAX, SECONDS_MAX, FittedClip
        from prepare.fit.clip_tracks import crop_of

        shot, (_, x, v) = self.shots[0], played
        times = shot.clip.times[shot.clip.times < min(self.tracks.release, SECONDS_MAX)]
        if len(times) < 2:
            return None
        near, matrix = crop_of(shot.camera, shot.masks.any(0), KEPT_SIDE)
        rows = np.arange(0, len(times), -(-len(times) // PICTURES_MAX))
        smooth = max(0.5 / matrix[0, 0] - 0.5, 0.01)  # [px]: what a smaller picture cannot show would flicker in it
        size, edge = (KEPT_SIDE, KEPT_SIDE), cv2.BORDER_REPLICATE
        pictures = [cv2.GaussianBlur(shot.clip.pictures[k], (0, 0), smooth) for k in rows]
        pictures = np.stack([cv2.warpAffine(p, matrix, size, borderMode=edge) for p in pictures])
        return FittedClip(pictures, times[rows], near, cage.held, x, v, self.tracks.planes).in_front(cage.vertices)

    def films(self, motion: np.ndarray) -> Section:
        """The first clip beside what was fitted, and with E halved and doubled; motion (F, 3, V, 3) of these."""
        from prepare.fit.clip_masks import backdrop_of
        from prepare.fit.clip_tracks import moments

        shot = self.shots[0]
        clip, behind = shot.clip, backdrop_of(shot.clip.pictures, shot.masks)
        made = np.zeros((3, *clip.pictures.shape), np.uint8)
        for k, row in enumerate(np.searchsorted(self.tracks.times, moments(clip))):
            for j in range(3):
                self.drawn.move(motion[row, j])
                made[j, k] = self.drawn.over(behind, shot.camera)
        off = np.abs(made[0].astype(np.int16) - clip.pictures).astype(np.uint8)
        fps = (len(clip.times) - 1) / float(clip.times[-1])
        films = {
            "the clip, fitted, their difference": (clip.pictures, made[0], off),
            "with half of Young's modulus, as fitted, with twice of it": (made[1], made[0], made[2]),
        }
        return Section("Films", pictures={text: film_of(rows, fps) for text, rows in films.items()})


def film_of(films: tuple[np.ndarray, ...], fps: float) -> str:
    """Films (F, H, W, 3) uint8 side by side, for a page: an element of HTML that holds them. Raises BadInput."""
    from display.headless.video import Video

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        height, width = films[0].shape[1:3]
        video = Video(path, width * len(films), height, fps=max(1.0, fps), frames=len(films[0]))
        for row in zip(*films, strict=True):
            video.write(np.concatenate(row, 1))
        video.close()
        data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<video controls loop muted autoplay playsinline src="data:video/mp4;base64,{data}"></video>'


class Simulator:
    """Rolls candidates out among the planes and in the gravity of the tracks; one solver a cage, whatever is held."""

    def __init__(self, tracks):
        self.tracks, self.solvers = tracks, {}

    def roll(self, cage, candidates: list) -> np.ndarray:
        """Places of the markers [m] (F, C, M, 3) of candidates, each a material and positions and velocities (V, 3)."""
        from sim.model import MAX_BODIES
        from sim.rollouts import Candidate, Rollouts

        t = self.tracks
        mesh = id(cage.vertices)
        if mesh not in self.solvers:
            way = np.nanmax(np.ptp(t.points[np.isfinite(t.points).all(2)], axis=0))
            apart = 2.0 * (np.ptp(cage.vertices, axis=0).max() + way)
            made = Rollouts(
                cage.vertices, cage.tets, cage.held, MAX_BODIES, planes=t.planes, gravity=t.gravity, apart=apart
            )
            self.solvers[mesh] = (made, cage.vertices)  # which lives as long, so that its number stays its own
        rollouts = self.solvers[mesh][0]
        rollouts.hold(cage.held)
        made = [Candidate(*c) for c in candidates]
        parts = [made[k : k + MAX_BODIES] for k in range(0, len(made), MAX_BODIES)]
        return np.concatenate([rollouts.run(part, t.times, cage.markers, t.release) for part in parts], axis=1)
