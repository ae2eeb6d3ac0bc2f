"""From a splat file to an asset file: bodies and static environments, with a summary for the user."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

from assets.asset import Asset, Cage
from assets.camera_file import cameras_of_splat, read_poses
from assets.file_access import atomic_write_all
from assets.formats.ply import write_ply
from assets.gaussians import Gaussians
from assets.orientation import describe_guess, question
from assets.splat_files import read_gaussians
from core.errors import BadInput
from core.material import ANIMATED_MATERIAL
from core.report import png_of
from core.runtime import running_arch
from prepare import standing
from prepare.cage.level_set import ComponentSolid
from prepare.environment.environment_pipeline import ENVIRONMENT_STEPS, EnvironmentOptions, prepare_environment
from prepare.pipeline import STEPS, VERSION, Options, of_first_sound_cage, prepare
from prepare.preparation_report import examine, report_names, report_texts
from prepare.progress import Checkpoints, Progress, StepProgress
from prepare.report_pictures import orientation_strip, strip_name
from prepare.rig.rig_source import RigSource, described, is_skinned, rig_source
from prepare.standing import stood_up

# Vertices of a cage unless the user says; the next number where a shape finds no sound cage with one. A second of a
# plush toy takes 0.6 s of a CPU core with 500, and 6 s with 2,000.
DEVICE_VERTICES = {"cpu": (500, 1000, 2000), "cuda": (2000,)}
ANIMATED_VERTICES = (2000,)  # of a body with a skeleton, whose joints fewer cannot bend
MAX_FLOATERS = 0.05  # of the Gaussians; more that lie apart are another component
Y_UP = (".glb", ".gltf")  # whose specification says so
MAX_PLANES = 8  # that the summary names


def prepare_file(
    path: str | Path,
    out: str | Path,
    options: Options | None = None,
    *,
    vertices: Sequence[int] = (),
    rig: str | Path | None = None,
    landmarks: str | Path | None = None,
    cage: Cage | None = None,
    progress: Progress | None = None,
    report: Callable[[str], None] = print,
    page: bool = False,
    quantised: bool = False,
) -> Path:
    """Prepare the splat file `path` and write the asset `out`, whole or not at all; `report` takes the summary.

    path      a splat file, or a mesh; a .glb may be skinned
    vertices  numbers to try in turn instead of the options', until there is a sound cage
    rig       a .glb whose motion the body takes over
    landmarks JSON file of the positions of the body's joints
    cage      in the splat's coordinates, to take instead of making one
    page      also write the report beside it: ASSET.report.html and ASSET.report.json
    quantised store it small, with the losses of assets/quantisation.py
    Raises BadInput, naming the file.
    """
    path, out = Path(path), Path(out)
    source, options = _source_of(path, options or Options(), rig, landmarks)
    gaussians = read_gaussians(path, report) if source is None or source.gaussians is None else source.gaussians
    counts = vertices or (options.vertices,)
    with _progress(path, STEPS if source is None else (*STEPS, "rig"), progress) as shown:
        make = partial(_body, path, gaussians, options, source, cage, shown)
        asset, solids, notes, checkpoints = of_first_sound_cage(counts, make, report)
    if checkpoints.resumed:
        notes.append(f"resumed after the step {checkpoints.resumed[-1]} of an earlier run")
    asset = replace(asset, provenance={"source": path.name} | asset.provenance)
    strip, texts = _strip(asset) if page else None, ()
    if page:
        numbers, pictures = examine(asset, solids)
        pictures = pictures if strip is None else {"up": strip} | pictures
        texts = report_texts(out.name, numbers, pictures, notes)
    files = [out, *([strip_name(out)] if strip is not None else []), *(report_names(out) if texts else ())]
    with atomic_write_all(*files) as (beside, *others):
        asset.check(str(out))  # before `save` does, which would name the temporary file
        asset.save(beside, quantised=quantised)
        if strip is not None:
            others.pop(0).write_bytes(png_of(strip))
        for other, text in zip(others, texts, strict=True):
            other.write_text(text, encoding="utf-8")
    checkpoints.clear()
    for line in notes + summary(asset.provenance):
        report(line)
    tell_alternatives(asset.provenance["up_probabilities"], out, strip, report)
    return out


@contextmanager
def _progress(path: Path, steps: tuple[str, ...], progress: Progress | None) -> Iterator[Progress]:
    """The caller's progress, or that of the steps on the screen. A BadInput inside comes to name the file."""
    shown = StepProgress(steps)
    try:
        yield progress or shown
    except BadInput as e:
        raise BadInput(f"{path}: {e}") from e
    finally:
        shown.close()


def _strip(asset: Asset) -> np.ndarray | None:
    """Picture of the axes that may point up, where the guess is not sure."""
    chances = asset.provenance["up_probabilities"]
    return orientation_strip(asset.gaussians, asset.provenance["up"], chances) if question(chances) else None


def _source_of(path: Path, options: Options, rig, landmarks) -> tuple[RigSource | None, Options]:
    """Source of the body's motion, if it has one, and the options with what it or the file's format says."""
    if path.suffix.lower() == ".h5":
        raise BadInput(f"{path}: is an asset already; a splat file (.ply, .spz, .sog ...) is needed")
    if options.pieces and (rig is not None or is_skinned(path)):
        raise BadInput(f"{path}: a rig animates one body; --pieces is for other splats")
    source = rig_source(path, rig, landmarks)
    if source is None and path.suffix.lower() in Y_UP:
        options = replace(options, up=options.up or "+y", front=options.front or 0.0)  # both are specified
    if source is not None:
        options = replace(options, front=options.front or 0.0)  # a motion has a front of its own
        options = replace(options, up=options.up or source.up, material=options.material or ANIMATED_MATERIAL)
    return source, options


def _body(
    path: Path,
    gaussians: Gaussians,
    options: Options,
    source: RigSource | None,
    cage: Cage | None,
    progress: Progress,
    vertices: int,
) -> tuple[Asset, list[ComponentSolid], list[str], Checkpoints]:
    """The body with so many vertices, standing or in motion; the solids of its components, notes, and what is kept
    until it is written. Raises BadInput."""
    options = replace(options, vertices=vertices)
    key = {} if cage is None else {"cage": [hash_of(cage.vertices), hash_of(cage.tets)]}
    checkpoints = Checkpoints(path, asdict(options) | key, VERSION)
    try:
        asset, solids, notes = _prepared_or_anew(gaussians, options, cage, progress, checkpoints)
        if source is not None:
            progress("rig", 0.0)
            asset = source.animate(asset, solids[0].distance)
            progress("rig", 1.0)
        elif len(solids) == 1 and not options.metres:
            asset, solids = stood_up(asset, solids)
    except BadInput:
        checkpoints.clear()
        raise
    return asset, solids, notes, checkpoints


def tell_alternatives(chances: dict, out: Path, strip: np.ndarray | None, report: Callable[[str], None]) -> None:
    """Name the other axes that may point up, and remove the strip of an earlier preparation if there is none now."""
    if strip is None:
        strip_name(out).unlink(missing_ok=True)
    if line := question(chances, None if strip is None else strip_name(out)):
        report(line)


def device_vertices(*, animated: bool) -> tuple[int, ...]:
    """Numbers of vertices that suit the device, to be tried in turn. Taichi must be running."""
    return ANIMATED_VERTICES if animated else DEVICE_VERTICES[running_arch()]


def hash_of(values: np.ndarray) -> str:
    """SHA-256 of an array's content."""
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


def _prepared_or_anew(gaussians, options: Options, cage: Cage | None, progress: Progress, checkpoints: Checkpoints):
    """Asset, solids of its components and notes of `prepare`; once more from the start if checkpoints fail it."""

    def attempt():
        solids, notes = [], []
        seen = {"look": solids.append, "say": notes.append}
        asset = prepare(gaussians, options, given=cage, progress=progress, checkpoints=checkpoints, **seen)
        return asset, solids, notes

    try:
        return attempt()
    except (BadInput, LookupError, TypeError, ValueError):
        if not checkpoints.resumed:
            raise
        checkpoints.clear()  # its arrays may be at fault
        return attempt()


def summary(provenance: dict) -> list[str]:
    """Lines that describe a prepared body, from its provenance."""
    counts, figures, options = provenance["counts"], provenance["figures"], provenance["options"]
    left_out = ", ".join(f"{counts[k]} {k}" for k in ("transparent", "huge", "apart", "stray") if counts[k])
    animation, cells = provenance.get("rig"), figures["cells"]
    cells = " as given" if cells == "given" else f" in {cells} cells"
    apart, lines = counts["apart"] + counts["stray"], []
    if figures["pieces"] > 1:
        lines.append(f"{figures['pieces']} pieces, each with a cage of its own and a body of its own in a scene")
    elif apart > MAX_FLOATERS * counts["read"] and not options.get("pieces"):
        kept = "the largest is taken"
        lines.append(f"the splat has pieces that lie apart: {kept}, {apart} Gaussians left out; --pieces keeps all")
    if counts.get("specks"):
        lines.append(f"{counts['specks']} more pieces are left out: too small or too flat for a cage")
    if counts.get("flap"):
        flap = f"a thin part of {counts['flap']} Gaussians under it, on which it would topple"
        lines.append(f"{flap}, is left out of the cage")
    return lines + [
        f"Gaussians: {counts['kept']} of {counts['read']}" + (f"; left out: {left_out}" if left_out else ""),
        f"up {_up_axis(provenance)}, largest extent {_size(provenance)}",
        *_front(provenance.get("front")),
        *([f"turned by {provenance['stood_up']:g} degrees, to stand as it rests"] if "stood_up" in provenance else ()),
        f"cage: {figures['vertices']} vertices, {figures['tets']} tets{cells}, smallest angle "
        f"{figures['min_dihedral']:.1f} degrees, volume {1e6 * figures['volume']:.4g} cm^3",
        f"inside the cage: {figures['inside']:.2%} of the opaque Gaussians; {figures['seconds']:.1f} s",
        *([standing.described(provenance["material"])] if "material" in provenance else ()),
        *(described(animation) if animation else ()),
    ]


def prepare_environment_file(
    path: str | Path,
    out: str | Path,
    options: EnvironmentOptions | None = None,
    *,
    progress: Progress | None = None,
    report: Callable[[str], None] = print,
    pictures: bool = False,
    quantised: bool = False,
) -> list[Path]:
    """Prepare the scene `path` and write the asset `out`, whole or not at all; `report` takes the summary.

    OUT_objectK.ply is written for each id K that is cut out, with `pictures` a strip where it is not sure which way is
    up. Returns all of these files. Raises BadInput, naming the file.
    """
    path, out = Path(path), Path(out)
    gaussians, options = read_gaussians(path, report), options or EnvironmentOptions()
    if options.poses is None and (known := cameras_of_splat(path)) is not None:
        options = replace(options, poses=read_poses(known))
        report(f"its cameras are known: {known}")
    with _progress(path, ENVIRONMENT_STEPS, progress) as shown:
        asset, objects = prepare_environment(gaussians, options, progress=shown)
    asset = replace(asset, provenance={"source": path.name} | asset.provenance)
    asset.check(str(out))
    strip = _strip(asset) if pictures else None
    files = [out, *(object_file(out, k) for k in objects), *([] if strip is None else [strip_name(out)])]
    with atomic_write_all(*files) as (beside, *others):
        if strip is not None:
            others.pop().write_bytes(png_of(strip))
        for other, g in zip(others, objects.values(), strict=True):
            write_ply(other, g)
        asset.save(beside, quantised=quantised)
    for k, g in objects.items():
        report(f"object {k}: {len(g)} Gaussians cut out")
    for line in environment_summary(asset):
        report(line)
    tell_alternatives(asset.provenance["up_probabilities"], out, strip, report)
    return files


def object_file(out: Path, object_id: int) -> Path:
    """Path of the Gaussians of an object id that is cut out."""
    return out.with_name(f"{out.stem}_object{object_id}.ply")


def environment_summary(asset: Asset) -> list[str]:
    """Lines that describe a prepared environment."""
    p, found = asset.provenance, asset.environment
    grids = ", ".join(f"{n:,} cells of {1000 * h:.0f} mm" for n, h in zip(p["cells"], p["spacings"], strict=True))
    lines = [
        f"{len(asset.gaussians):,} Gaussians, up {_up_axis(p)}, leaning by {p['lean']:.1f} degrees, "
        f"largest extent {_size(p)}"
    ]
    for kind, height, x0, z0, x1, z1 in found.planes[:MAX_PLANES]:
        centre = f"({0.5 * (x0 + x1):.2f}, {0.5 * (z0 + z1):.2f})"
        lines.append(f"  {kind:5} at {height:5.2f} m, {x1 - x0:.2f} x {z1 - z0:.2f} m around {centre}")
    if len(found.planes) > MAX_PLANES:
        lines.append(f"  and {len(found.planes) - MAX_PLANES} more planes")
    lines.append(
        f"bodies drop on the {p['drop_on']}, where a disc of {found.clear_radius:.2f} m is free; grids: {grids}"
    )
    return [*lines, f"{p['seconds']:.1f} s"]


def _up_axis(p: dict) -> str:
    return p["up"] if p["options"]["up"] else describe_guess(p["up"], p["up_probabilities"])


def _front(front: dict | None) -> list[str]:
    """The line that says what was guessed of the front."""
    if front is None:
        return []
    if front["turned"]:
        how = f"guessed, {front['sure']:.0%} sure; --front DEG overrides, 0 keeps the file's"
        return [f"front: turned to the player by {-front['angle']:.0f} degrees ({how})"]
    how = f"the guess, {front['angle']:.0f} degrees to the side, is {front['sure']:.0%} sure"
    return [f"front: the file's, as {how}; in play , and . turn it and Ctrl+K keeps that, or --front DEG"]


def _size(p: dict) -> str:
    how = "guessed" if p["up_probabilities"] else "from its cameras' height"
    return f"{p['size']:.3g} m" + ("" if p["options"]["scale"] else f" ({how}; --scale overrides)")
