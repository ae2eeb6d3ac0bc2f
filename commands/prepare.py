"""`vrgs.py prepare`: make a splat an elastic body, or a room playable."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from assets.file_access import file_size
from commands import options as cli
from commands.prepared import cached_body, cached_environment, is_animated, pipeline_options, suited
from core.errors import BadInput
from core.material import MATERIALS
from core.runtime import start_taichi

WHERE = cli.OneOf(required=True)
OF_BODIES = ("--material", "--mesher", "--cage", "--rig", "--landmarks", "--no-report")


@dataclass(kw_only=True)
class PrepareOptions(cli.Preparation):
    EXAMPLES = (
        "prepare cat.ply --out cat.h5 --vertices 2000",
        "prepare cat.ply --cage cat.usda --out cat.h5",
        "prepare room.ply --static --out room.h5",
    )
    CONDITIONS = (
        cli.Condition(("--cell", "--cut"), lambda o: o.static, "belongs to --static"),
        cli.Condition(("--pieces",), lambda o: not o.static, "belongs to bodies; a scene has --cut"),
        cli.Condition(
            ("--front", "--vertices", "--cells", *OF_BODIES),
            lambda o: not o.static,
            "belongs to bodies; with --static nothing is simulated",
        ),
        cli.Condition(
            ("--cell", "--cut", *OF_BODIES, "--force", "--quantised"), lambda o: not o.cache, "belongs to --out"
        ),
        cli.Condition(("--up", "--scale"), lambda o: not (o.cache and o.static), "belongs to --out"),
        cli.Condition(
            ("--vertices", "--cells", "--mesher", "--pieces"),
            lambda o: not o.cage,
            "is not for --cage",
        ),
    )

    splats: Path = cli.argument("SPLATS", f"{cli.SPLATS}, skinned .glb; --static: or .h5")
    out: Path | None = cli.option("ASSET.h5", "file to write", one_of=WHERE)
    cache: bool = cli.switch("store it where --body and --stage look, so that play starts at once", one_of=WHERE)
    rig: Path | None = cli.option("RIG.glb", "animate a standing person by this rig's motion")
    landmarks: Path | None = cli.option("L.json", "positions of the person's joints (default: guessed)")
    material: str | None = cli.option("NAME", f"{', '.join(MATERIALS)} (default plush; with a rig: flesh)")
    static: bool = cli.switch("the splat is a room or garden to play in")
    cell: cli.Amount | None = cli.option("M", "--static: spacing of the distance grid (default: by size)")
    cut: list[cli.Count] | None = cli.option("ID", "--static: objects to cut out, each into a file")
    force: bool = cli.switch("overwrite OUT")
    mesher: Literal["stuffing", "tetgen"] = cli.option(
        None, "how the tetrahedra are made (default stuffing; tetgen: see requirements-tetgen.txt)", "stuffing"
    )
    cage: Path | None = cli.option(
        "CAGE.usd", "take the tetrahedral mesh of an OpenUSD file, in the splat's coordinates, as its cage"
    )
    no_report: bool = cli.switch("do not write ASSET.report.html and ASSET.report.json")
    quantised: bool = cli.switch("a third to a fifth of the file's size, with barely visible losses (docs/formats.md)")
    arch: cli.Arch | None = cli.arch_option()


def prepare(options: PrepareOptions) -> None:
    """Prepare a body, or with --static an environment, after a check of where its files go. Raises BadInput."""
    o = options
    if o.cache:
        print(cached_environment(o.splats, o.arch) if o.static else cached_body(o.splats, o, o.arch)[0])
        return
    from prepare.environment.environment_pipeline import EnvironmentOptions
    from prepare.preparation_report import report_names
    from prepare.prepared_files import device_vertices, object_file, prepare_environment_file, prepare_file
    from prepare.report_pictures import strip_name

    out, cut = o.out, tuple(sorted(set(o.cut or ())))
    file_size(o.splats)  # before other errors
    if out.suffix.lower() != ".h5":
        raise BadInput(f"{out}: an asset's name ends in .h5")
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    reports = () if o.static or o.no_report else report_names(out)
    strips = () if o.up or (o.no_report and not o.static) else (strip_name(out),)
    for file in (out, *strips, *reports, *(object_file(out, k) for k in cut)):
        if file.exists() and not o.force:
            raise BadInput(f"{file}: exists already; --force overwrites it")
    cage = None
    if o.cage is not None:
        from prepare.cage.cage_file import read_cage

        cage = read_cage(o.cage)
    start_taichi(o.arch)
    if o.static:
        environment = EnvironmentOptions(up=o.up, scale=o.scale, cell=o.cell, cut=cut)
        for file in prepare_environment_file(o.splats, out, environment, pictures=True, quantised=o.quantised):
            print(f"wrote {file}")
        return
    made = not (o.vertices or cage)
    vertices = device_vertices(animated=is_animated(o.splats, o.rig)) if made else ()
    count = vertices[0] if made else o.vertices or len(cage.vertices)
    if vertices:
        print(suited(vertices[0]))
    prepare_file(
        o.splats,
        out,
        replace(pipeline_options(o, count), material=o.material, mesher=o.mesher),
        vertices=vertices,
        rig=o.rig,
        landmarks=o.landmarks,
        cage=cage,
        quantised=o.quantised,
        page=bool(reports),
    )
    print(f"wrote {out}" + (f" and {reports[0]}" if reports else ""))
