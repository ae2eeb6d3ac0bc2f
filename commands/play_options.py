"""Options of playing a scene: what is played, where it is shown, what is written."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from assets.library import is_asset
from commands import options as cli

INPUT, WHERE = cli.OneOf(), cli.OneOf()
PREPARATION = cli.Condition(
    ("--up", "--front", "--scale", "--vertices", "--cells", "--pieces"),
    lambda o: o.replay or not all(map(is_asset, o.body or ())),
    "is for a splat file given with --body; for an asset or a room, see vrgs.py prepare",
)
STATE = cli.Condition(("--state",), lambda o: not o.replay, "is not for a replay, which has its own start")


@dataclass(kw_only=True)
class SceneOptions(cli.Preparation):
    """The scene that is played, and for how long. `options`: those of the scene, by name."""

    CONDITIONS = (STATE, PREPARATION)

    scene: str = cli.option(
        "NAME|ROOM/|FILE.py",
        "demo (vrgs.py scenes), captured room, or scene file, which is run (default ring_toss; with --body sandbox)",
        "ring_toss",
    )
    arch: cli.Arch | None = cli.arch_option()
    interaction: cli.Setting = cli.option(None, "a grip deforms and throws bodies, or moves them rigidly", "physics")
    embedding: Literal["two-level", "one-level"] = cli.option(None, "how Gaussians follow the cage", "two-level")
    frames: cli.Count | None = cli.option("N", "stop after N frames")
    state: Path | None = cli.option("FILE.h5", "continue from a saved state, with its scene, bodies and view")
    replay: Path | None = cli.option("FILE.h5", "replay recorded input and compare the states", one_of=INPUT)
    seed: int = cli.seed_option()
    body: list[str] | None = cli.option("FILE", "splat or asset to play with; several fill several roles", repeat=True)
    stage: str | None = cli.option("ROOM", "room to play in: a splat, or an asset prepared with --static")
    material: str | None = cli.option("NAME", "material of --body (default: its own; see: vrgs.py materials)")
    detail: cli.Detail = cli.option(None, "assets as shipped, or at the paper's sizes (python -m studio)", "shipped")
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(kw_only=True)
class DisplayOptions(cli.Options):
    """The display of a play, and what is written of it."""

    xr: bool = cli.switch("play in a headset", one_of=WHERE)
    headless: bool = cli.switch("no window: the scene's scripted hand plays", one_of=WHERE)
    web: cli.Port | None = cli.option(
        "PORT", "play in a browser; prints the address (default port: 8090, or the next free one)", one_of=WHERE, bare=0
    )
    host: str | None = cli.option("ADDRESS", "--web: address to listen on (default 127.0.0.1: this machine only)")
    sort: cli.Sort | None = cli.sort_option("radial")
    size: cli.Size | None = cli.option("WxH", "picture size (default 960x540; a window: its last size)")
    render_scale: cli.RenderScale = cli.option("S", "--xr: scale of the headset's recommended width and height", 1.0)
    stereo: bool = cli.switch("headless: draw two eyes, 63 mm apart")
    record: Path | None = cli.option("OUT.mp4", "write a film")
    snapshot: cli.PictureName | None = cli.option("OUT.png", "write the last frame: .png, .jpg or .webp")
    save_state: Path | None = cli.option("FILE.h5", "write the state at the end, to continue with --state FILE.h5")
    sound: Literal["auto", "on", "off"] = cli.option(
        None, "impact sounds, also in the film of --record; auto: if there are a sound device and package", "auto"
    )
    stats: Path | None = cli.option("OUT.json", "write timings and counts")
    record_input: Path | None = cli.option("FILE.h5", "record your input, for --replay", one_of=INPUT)
    study: Path | None = cli.option("OUT.h5", "record the trials in a user-study file (see: vrgs.py study)")
    participant: str | None = cli.option("NAME", "--study: name of the player, by which both settings are compared")


@dataclass(kw_only=True)
class PlayOptions(SceneOptions, DisplayOptions):
    """All options of playing. `driven`: the Scene that a Python program plays with hands of its own."""

    EXAMPLES = (
        "                                       play the ring toss in a window",
        "--body cat.ply                         drop your own splat on the table",
        "--scene my_scene.py                    play a scene file of yours (docs/writing_a_scene.md)",
        "--scene ROOM/                          play in a room that was captured (vrgs.py capture)",
        "--scene ring_toss --headless --record toss.mp4 --stats toss.json",
        "--xr --record-input play.h5            play in a headset and record what you do",
        "--web                                  play in a browser: for machines without a display",
        "--replay play.h5                       see it again; with --headless --record play.mp4: film it",
        "scenes                                 list the demos",
        "view cat.ply                           look at a splat from all sides",
        "render cat.ply --turntable --out cat.mp4",
        "render cat.ply --camera cam.json --out cat.png",
        "prepare cat.ply --out cat.h5 --vertices 2000",
        "convert cat.sog cat.compressed.ply     between splat formats, and what was lost",
        "--scene sandbox --stage room.ply --body cat.ply",
        "tune cat.h5                            how stiff should it be?",
        "check --quick",
    )
    CONDITIONS = (
        cli.Condition(("--render-scale",), lambda o: o.xr, "belongs to --xr; elsewhere: --size"),
        cli.Condition(("--size",), lambda o: not o.xr, "is not for --xr: the headset decides; see --render-scale"),
        cli.Condition(("--stereo",), lambda o: o.headless, "belongs to --headless"),
        cli.Condition(("--host",), lambda o: o.web is not None, "belongs to --web"),
        STATE,
        cli.Condition(
            ("--sound",),
            lambda o: o.sound != "on" or o.record or not (o.headless or o.web is not None),
            "on: there is no sound here, except in the film of --record",
        ),
        cli.Condition(("--participant",), lambda o: o.study, "belongs to --study OUT.h5"),
        PREPARATION,
    )

    driven: Any = None
