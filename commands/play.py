"""`vrgs.py` without a command: the options of playing a scene, and all that a play needs, opened in order."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from commands.conditions import Condition
from commands.options import (
    add_arch,
    add_preparation,
    add_scene_options,
    add_sort,
    picture_name,
    port,
    positive,
    render_scale,
    size,
)
from commands.prepared import is_asset, prepared_bodies, prepared_capture, prepared_stage
from core.errors import BadInput
from core.runtime import start_taichi
from render import MOVING_SORT
from scenes.registry import is_scene_file, label

if TYPE_CHECKING:
    from commands.play_session import Session
    from display.keep.state_file import SceneState
    from display.preferences import Preferences
    from display.protocol import Display
    from display.record.replay import Replay
    from scenes.scene import Scene

EXAMPLES = """examples:
  python vrgs.py                                        play the ring toss in a window
  python vrgs.py --body cat.ply                         drop your own splat on the table
  python vrgs.py --scene my_scene.py                    play a scene file of yours (docs/writing_a_scene.md)
  python vrgs.py --scene ROOM/                          play in a room that was captured (vrgs.py capture)
  python vrgs.py --scene ring_toss --headless --record toss.mp4 --stats toss.json
  python vrgs.py --xr --record-input play.h5            play in a headset, and keep what you do
  python vrgs.py --web                                  play in a browser: for machines without a display
  python vrgs.py --replay play.h5                       see it again; with --headless --record play.mp4: film it
  python vrgs.py scenes                                 list the demos
  python vrgs.py view cat.ply                           look at a splat from all sides
  python vrgs.py render cat.ply --turntable --out cat.mp4
  python vrgs.py render cat.ply --camera cam.json --out cat.png
  python vrgs.py prepare cat.ply --out cat.h5 --vertices 2000
  python vrgs.py convert cat.sog cat.compressed.ply     between splat formats, and what was lost
  python vrgs.py --scene sandbox --stage room.ply --body cat.ply
  python vrgs.py tune cat.h5                            how stiff should it be?
  python vrgs.py check --quick
"""
FPS = 60  # [1/s] of a headless play
SIZE = (960, 540)  # [px] of a headless play
PREPARATION = Condition(
    ("--up", "--front", "--scale", "--vertices", "--cells", "--pieces"),
    lambda args: args.replay or not all(map(is_asset, args.body or ())),
    "is for a splat file given by --body; an asset or a room of its own: see vrgs.py prepare",
)
STATE_CONDITION = Condition(
    ("--state",), lambda args: not args.replay, "is not for a replay, which begins where it did"
)
CONDITIONS = (
    Condition(("--render-scale",), lambda args: args.xr, "belongs to --xr; elsewhere: --size"),
    Condition(("--size",), lambda args: not args.xr, "is not for --xr: a headset says what it takes; --render-scale"),
    Condition(("--stereo",), lambda args: args.headless, "belongs to --headless"),
    Condition(("--host",), lambda args: args.web is not None, "belongs to --web"),
    STATE_CONDITION,
    Condition(
        ("--sound",),
        lambda args: args.sound != "on" or args.record or not (args.headless or args.web is not None),
        "on: nothing is heard here, but in the film of --record",
    ),
    Condition(("--participant",), lambda args: args.study, "belongs to --study OUT.h5"),
    PREPARATION,
)
SECONDS = 5  # [s] of a headless play of a scene without a game


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of playing."""
    add_scene_arguments(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--xr", action="store_true", help="play in a headset")
    where.add_argument("--headless", action="store_true", help="no window: the scene's scripted hand plays")
    text = "play in a browser; prints the address (default port: 8090, or the next free one)"
    where.add_argument("--web", type=port, nargs="?", const=0, metavar="PORT", help=text)
    text = "--web: address to listen on (default 127.0.0.1: this machine alone)"
    parser.add_argument("--host", metavar="ADDRESS", help=text)
    add_sort(parser, MOVING_SORT)
    text = "picture size (default 960x540, of a window: the last one's)"
    parser.add_argument("--size", type=size, metavar="WxH", help=text)
    text = "--xr: factor of the width and height that the headset recommends"
    parser.add_argument("--render-scale", type=render_scale, default=1.0, metavar="S", help=text)
    parser.add_argument("--stereo", action="store_true", help="headless: draw two eyes, 63 mm apart")
    parser.add_argument("--record", type=Path, metavar="OUT.mp4", help="write a film")
    text = "write the last frame: .png, .jpg or .webp"
    parser.add_argument("--snapshot", type=picture_name, metavar="OUT.png", help=text)
    text = "write the state of the scene at the end; --state FILE.h5 goes on from it"
    parser.add_argument("--save-state", type=Path, metavar="FILE.h5", help=text)
    text = "sound of impacts, also in the film of --record; auto: if there is a device and the package for it"
    parser.add_argument("--sound", choices=("auto", "on", "off"), default="auto", help=text)
    parser.add_argument("--stats", type=Path, metavar="OUT.json", help="write timings and counts")
    again = parser.add_mutually_exclusive_group()
    text = "record your input, to be replayed"
    again.add_argument("--record-input", type=Path, metavar="FILE.h5", help=text)
    text = "replay recorded input, and compare the states"
    again.add_argument("--replay", type=Path, metavar="FILE.h5", help=text)
    text = "record the play in this file of a user study (see: vrgs.py study)"
    parser.add_argument("--study", type=Path, metavar="OUT.h5", help=text)
    text = "--study: name of the player, by which both settings are compared"
    parser.add_argument("--participant", metavar="NAME", help=text)
    add_scene_options(parser)


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what is played, and how long."""
    text = "demo to play (see: vrgs.py scenes), a captured room, or your own scene file, which is run (default "
    text += "ring_toss; with --body sandbox)"
    parser.add_argument("--scene", default="ring_toss", metavar="NAME|ROOM/|FILE.py", help=text)
    add_arch(parser)
    text = "effect of a grip: it deforms and throws bodies, or moves them as they are"
    parser.add_argument("--interaction", choices=("physics", "transform"), default="physics", help=text)
    text = "how Gaussians follow the cage"
    parser.add_argument("--embedding", choices=("two-level", "one-level"), default="two-level", help=text)
    parser.add_argument("--frames", type=positive(int), metavar="N", help="stop after N frames")
    text = "go on from a saved state, with its scene, bodies and view"
    parser.add_argument("--state", type=Path, metavar="FILE.h5", help=text)
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of all random numbers (default 0)")
    text = "splat file or prepared asset to play with; several times: in the scene's roles, in their order"
    parser.add_argument("--body", metavar="FILE", action="append", help=text)
    text = "a room to play in, a splat or prepared with --static"
    parser.add_argument("--stage", metavar="ROOM", help=text)
    text = "material of --body (default: the asset's own; see: vrgs.py materials)"
    parser.add_argument("--material", metavar="NAME", help=text)
    text = "assets as shipped, or at the paper's sizes (make them: python -m studio --detail paper)"
    parser.add_argument("--detail", choices=("shipped", "paper"), default="shipped", help=text)
    add_preparation(parser, "--body: ")


@contextlib.contextmanager
def open_session(args: argparse.Namespace) -> Iterator[Session]:
    """Open all that the options request, closed at the end. Raises BadInput before any long operation."""
    from commands.play_session import Outputs, Session
    from display.keep.keeper import Keeper
    from display.preferences import Preferences

    if args.body and "--scene" not in getattr(args, "given", ("--scene",)):
        args.scene = "sandbox"
    preferences = Preferences() if args.headless else Preferences.of_user()
    replay, state = open_replay(args), open_state(args)
    scene = load_scene(args, replay)
    begin = state.settings.time if state else 0.0
    with (
        open_sound(args, preferences) as sound,
        open_display(args, scene, replay, preferences=preferences, begin=begin) as display,
        open_film(args, display) as film,
        open_recording(args) as recording,
        open_study(args, scene) as study,
        Keeper(label(args.scene), preferences) as keeper,
    ):
        start_taichi(args.arch, args.seed)
        options = {"interaction": args.interaction, "embedding": args.embedding, "sort": args.sort}
        options |= {"depth": bool(args.xr and display.depth), "fingers": bool(args.xr)}
        if replay:
            options = replay.world_options(options)
        views = {"views": 2 if args.stereo or args.xr else 1, "props": display.props() if args.xr else []}
        outputs = Outputs(film, recording, study, keeper, sound)
        kept = {
            "replay": replay,
            "load": lambda args: load_scene(args, None),
            "title": title_of,
            "options": options | views,
            "preferences": preferences,
            "reserve": [asset for asset, _, _ in state.added] if state else [],
        }
        with Session(args, scene, display, outputs, **kept) as session:
            if state:
                from display.keep.scene_state import put_state

                put_state(session.world, state, str(args.state))
            if recording:
                recording.begin(args, options)
            yield session


def title_of(args: argparse.Namespace) -> str:
    """Title of the window."""
    return f"VR-GS: {label(args.scene)}"


def load_scene(args: argparse.Namespace, replay: Replay | None) -> Scene:
    """The scene with the options' bodies, material and room, prepared if they are splat files. Raises BadInput.

    A line says which role each of them plays.
    """
    from assets.room_folder import read_room
    from scenes import registry

    if args.detail == "paper":
        from scenes.paper_demos import paper_demo_of, use_paper_assets

        use_paper_assets(paper_demo_of(args.scene, args.options or {}))
    prepared_capture(args)
    bodies, stage = prepared_bodies(args), prepared_stage(args)
    material = args.material
    if replay and material is None:
        material = replay.implied_material(args.scene, bodies[0] if bodies else None)
    users = {"body": bodies, "material": material, "stage": stage, "resize": args.scale is None}
    scene = registry.load(args.scene, **users, **(args.options or {}))
    if not scene.cast:
        return scene
    files = dict(zip([*bodies, stage], [*(args.body or ()), args.stage], strict=True))
    if room := (args.options or {}).get("capture"):
        files[str(Path(room) / read_room(room).background)] = room
    cast = tuple((Path(files[asset]).name, role) for asset, role in scene.cast)
    print("; ".join(f"{file} is {role}" for file, role in cast), flush=True)
    return replace(scene, cast=cast)


def open_replay(args: argparse.Namespace) -> Replay | None:
    """The recording to be replayed, whose options become those of the command."""
    if not args.replay:
        return None
    if args.xr:
        raise BadInput("--replay is seen in a window or with --headless: leave out --xr")
    from display.record.replay import Replay

    replay, named = Replay.load(args.replay), args.scene
    asked = {flag: getattr(args, flag[2:], None) for flag in getattr(args, "given", ())}
    replay.set_options(args)
    check_named(args, named, args.replay)
    for flag, value in asked.items():
        if value != getattr(args, flag[2:], None):
            raise BadInput(f"{flag} {value}: the recording was made with {getattr(args, flag[2:])}, which stays")
    return replay


def open_state(args: argparse.Namespace) -> SceneState | None:
    """The state to go on from, whose options become those of the command."""
    if not args.state:
        return None
    from display.keep.state_file import read_state
    from display.record.recording_reader import OPTIONS

    state, named = read_state(args.state), args.scene
    known = {key: state.about[key] for key in OPTIONS if key in state.about and key != "state"}
    take_options(args, known, "state was saved")
    check_named(args, named, args.state)
    args.arch = args.arch or state.about.get("arch")
    return state


def check_named(args: argparse.Namespace, named: str, file: Path) -> None:
    """Raise BadInput if a file asks for a scene file that the command line has not `named`: it would be run."""
    if is_scene_file(args.scene) and args.scene != named:
        raise BadInput(f"{file}: was played in a scene file; name it too: --scene {args.scene}")


def take_options(args: argparse.Namespace, options: dict, what: str) -> None:
    """Give the command these options. Raises BadInput if another value was asked for."""
    for key, value in options.items():
        if f"--{key}" in getattr(args, "given", ()) and getattr(args, key) != value:
            raise BadInput(f"--{key} {getattr(args, key)}: the {what} with {value}, which stays")
        setattr(args, key, value)


def open_recording(args: argparse.Namespace):
    """The recording of the user's input, or a context of None."""
    if not args.record_input:
        return contextlib.nullcontext()
    from display.record.recording import Recording

    return Recording(args.record_input)


def open_study(args: argparse.Namespace, scene: Scene):
    """The log of the participant's trials, or a context of None."""
    if not args.study:
        return contextlib.nullcontext()
    from display.study.study_file import StudyLog

    options = args.options or {}
    device = "headset" if args.xr else "headless" if args.headless else "window" if args.web is None else "browser"
    return StudyLog(
        args.study,
        participant=(args.participant or "").strip(),
        task=" ".join([label(args.scene), *(f"{key}={value}" for key, value in sorted(options.items()))]),
        device=device,
        about={"options": options, "roles": {role: file for file, role in scene.cast}},
    )


def open_sound(args: argparse.Namespace, preferences: Preferences):
    """The sound of the play and of its film, or a context of None. Open it first: it ends when the film is complete."""
    heard = not args.headless and args.web is None
    if args.sound == "off" or not (heard or args.record):
        return contextlib.nullcontext()
    from display.sound.sound import Sound

    return Sound(film=args.record, heard=heard, asked=args.sound == "on", preferences=preferences)


def open_display(
    args: argparse.Namespace,
    scene: Scene,
    replay: Replay | None = None,
    *,
    preferences: Preferences | None = None,
    begin: float = 0.0,
) -> Display:
    """The headset, the browser, the window, or, with --headless or without a screen, the files.

    A headless play begins `begin` [s] after the scene's start.
    """
    for file in filter(None, (args.stats, args.snapshot, args.save_state)):
        from assets.file_access import check_writable

        check_writable(file)
    if args.web is not None:
        from display.web.browser import Browser

        options = {"host": args.host, "port": args.web, "size": args.size, "name": label(args.scene)}
        return Browser(scene, title=title_of(args), preferences=preferences, **options)
    if args.xr:
        from display.xr.headset import Headset

        marks = not args.record  # markers do not belong in a film
        return Headset(scene, title=title_of(args), scale=args.render_scale, marks=marks)
    if not args.headless:
        from display.window.gl_window import has_display

        if has_display():
            from display.window.window import Window

            width, height = args.size or (None, None)
            kept = {"preferences": preferences, "name": label(args.scene)}
            return Window(scene, title=title_of(args), width=width, height=height, hint=replay is None, **kept)
        args.headless = True
        args.record = args.record or Path(f"{label(args.scene)}.mp4")
        args.snapshot = args.snapshot or Path(f"{label(args.scene)}.png")
        files = f"{args.record} and {args.snapshot}"
        print(f"no display: the scripted hand plays; writing {files} (--web: play in a browser)", file=sys.stderr)
    from display.headless.headless import Headless

    frames = args.frames or max(1, round(FPS * ((scene.game.duration if scene.game else SECONDS) - begin)))
    frames = min(args.frames or len(replay), len(replay)) if replay else frames
    views = 2 if args.stereo else 1
    width, height = args.size or SIZE
    out = {"record": None if replay else args.record, "snapshot": args.snapshot}
    return Headless(
        scene, width=width, height=height, frames=frames, views=views, every=2, scripted=replay is None, **out
    )


def open_film(args: argparse.Namespace, display: Display):
    """The film of a window, a headset or a replay, or a context of None; a headless play, in which all frames are
    equally long, films itself."""
    if (args.headless and not args.replay) or not args.record:
        return contextlib.nullcontext()
    from display.headless.video import FilmWriter

    return contextlib.closing(FilmWriter(args.record, *display.size, views=2 if args.stereo else 1))
