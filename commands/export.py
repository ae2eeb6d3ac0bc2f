"""`vrgs.py export`: write a played scene for other programs: splats, cages with fields, surfaces; one or a sequence."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from assets.file_access import check_writable
from commands import options as cli
from commands.play import PREPARATION, STATE, PlayOptions, SceneOptions, open_session
from core.errors import BadInput

Kind = Literal["ply", "compressed.ply", "spz", "splat", "vtu", "obj"]


@dataclass(kw_only=True)
class ExportOptions(SceneOptions):
    EXAMPLES = (
        "export --scene ring_toss --frames 90 --out toss.ply",
        "export --scene ring_toss --every 2 --out toss/ --format spz",
        "export --scene sandbox --body cat.ply --frames 60 --only 0 --out cat.vtu",
        "export --replay play.h5 --every 4 --out play/",
    )
    CONDITIONS = (
        STATE,
        cli.Condition(("--format",), lambda o: is_folder(o.out), "is for a folder: a file's name says its kind"),
        cli.Condition(("--every",), lambda o: is_folder(o.out), "is for a sequence: --out must be a folder"),
        cli.Condition(("--no-shadows",), lambda o: kind_of(o) not in ("vtu", "obj"), "is for splats, not for cages"),
        PREPARATION,
    )

    out: Path = cli.option(
        "FILE|DIR", f"file of the last frame (.{', .'.join(get_args(Kind))}), or folder of a sequence", cli.REQUIRED
    )
    every: cli.Count | None = cli.option("N", "sequence: every N-th frame, of 60 a second (default 2)")
    format: Kind = cli.option(None, "sequence: kind of its files (default ply)", "ply")
    only: str | None = cli.option("BODY", "one body, by its number or the name of its asset")
    no_shadows: bool = cli.switch("splats: colours as in full light")


def kind_of(options: ExportOptions) -> str:
    """The kind of file that is asked for."""
    return options.format if is_folder(options.out) else options.out.suffix.lower().lstrip(".")


def is_folder(path: Path) -> bool:
    """True if `--out` names a folder: one that is there, or a name without an ending."""
    return path.is_dir() or not path.suffix


def export(options: ExportOptions) -> None:
    """Play the scene and write what --out names. Raises BadInput."""
    from display.keep.scene_export import export_suffix, exporter

    sequence, start, files = is_folder(options.out), time.perf_counter(), []
    check_out(options, sequence)
    if not sequence:
        export_suffix(options.out)
    every = options.every or 2
    played = PlayOptions(**options.values_of(SceneOptions), headless=True, size=(16, 16), sort="z", sound="off")
    with open_session(played) as session:
        world, body = session.world, None
        for index, frame in enumerate(session.frames()):
            world.step(frame)
            body = find_body(world, options.only) if index == 0 else body
            if sequence and index % every == 0:
                files.append(options.out / f"frame_{index:05d}.{options.format}")
                exporter(world, files[-1], body=body, shadows=not options.no_shadows)()
        if not sequence:
            files.append(options.out)
            exporter(world, options.out, body=body, shadows=not options.no_shadows)()
    size, count = sum(f.stat().st_size for f in files) / 1e6, len(files)
    what = f"{count} files" if sequence else f"frame {index + 1}"
    print(f"{options.out}: {what}, {size:.1f} MB, {time.perf_counter() - start:.1f} s")


def check_out(options: ExportOptions, sequence: bool) -> None:
    """Make the folder of a sequence, or check that the file can be written. Raises BadInput."""
    if not sequence:
        check_writable(options.out)
        return
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise BadInput(f"{options.out}: cannot make this folder ({e.strerror})") from e
    check_writable(options.out / f"frame_00000.{options.format}")


def find_body(world, wanted: str | None) -> int | None:
    """Index of the body of a number or name; None: of all. Raises BadInput that lists them."""
    if wanted is None:
        return None
    names = [Path(body.name).stem for body in world.bodies()]
    if wanted.isdecimal() and int(wanted) < len(names):
        return int(wanted)
    if Path(wanted).stem in names:
        return names.index(Path(wanted).stem)
    there = ", ".join(f"{k} {name}" for k, name in enumerate(names)) or "none"
    raise BadInput(f"--only {wanted}: there is no such body; there are {there}")
