"""`vrgs.py` without a command: the options of playing a scene, and all that a play needs, opened in order."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from assets.file_access import check_writable
from commands import options as cli
from commands.prepared import is_asset, prepared_bodies, prepared_capture, prepared_stage
from core.errors import BadInput
from core.runtime import start_taichi
from scenes.registry import is_scene_file, label

if TYPE_CHECKING:
    from commands.play_session import Session
    from display.keep.state_file import SceneState
    from display.preferences import Preferences
    from display.protocol import Display
    from display.record.replay import Replay
    from scenes.scene import Scene

FPS = 60  # [1/s] of a headless play
SIZE = (960, 540)  # [px] of a headless play
SECONDS = 5  # [s] of a headless play of a scene without a game
INPUT, WHERE = cli.OneOf(), cli.OneOf()
PREPARATION = cli.Condition(
    ("--up", "--front", "--scale", "--vertices", "--cells", "--pieces"),
    lambda o: o.replay or not all(map(is_asset, o.body or ())),
    "is for a splat file given by --body; an asset or a room of its own: see vrgs.py prepare",
)
STATE = cli.Condition(("--state",), lambda o: not o.replay, "is not for a replay, which begins where it did")


@dataclass(kw_only=True)
class SceneOptions(cli.Preparation):
    """What is played, and how long. `options`: those of the scene, by name."""

    CONDITIONS = (STATE, PREPARATION)

    scene: str = cli.option(
        "NAME|ROOM/|FILE.py",
        "demo (vrgs.py scenes), captured room, or scene file, which is run (default ring_toss; with --body sandbox)",
        "ring_toss",
    )
    arch: cli.Arch | None = cli.arch_option()
    interaction: cli.Setting = cli.option(
        None, "effect of a grip: it deforms and throws bodies, or moves them as they are", "physics"
    )
    embedding: Literal["two-level", "one-level"] = cli.option(None, "how Gaussians follow the cage", "two-level")
    frames: cli.Count | None = cli.option("N", "stop after N frames")
    state: Path | None = cli.option("FILE.h5", "go on from a saved state, with its scene, bodies and view")
    replay: Path | None = cli.option("FILE.h5", "replay recorded input, and compare the states", one_of=INPUT)
    seed: int = cli.seed_option()
    body: list[str] | None = cli.option(
        "FILE", "splat or asset to play with; several: in the scene's roles", repeat=True
    )
    stage: str | None = cli.option("ROOM", "a room to play in, a splat or prepared with --static")
    material: str | None = cli.option("NAME", "material of --body (default: its own; see: vrgs.py materials)")
    detail: cli.Detail = cli.option(None, "assets as shipped, or at the paper's sizes (python -m studio)", "shipped")
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(kw_only=True)
class DisplayOptions(cli.Options):
    """Where a scene is shown, and what is written of the play."""

    xr: bool = cli.switch("play in a headset", one_of=WHERE)
    headless: bool = cli.switch("no window: the scene's scripted hand plays", one_of=WHERE)
    web: cli.Port | None = cli.option(
        "PORT", "play in a browser; prints the address (default port: 8090, or the next free one)", one_of=WHERE, bare=0
    )
    host: str | None = cli.option("ADDRESS", "--web: address to listen on (default 127.0.0.1: this machine alone)")
    sort: cli.Sort | None = cli.sort_option("radial")
    size: cli.Size | None = cli.option("WxH", "picture size (default 960x540, of a window: the last one's)")
    render_scale: cli.RenderScale = cli.option("S", "--xr: factor of the headset's recommended width and height", 1.0)
    stereo: bool = cli.switch("headless: draw two eyes, 63 mm apart")
    record: Path | None = cli.option("OUT.mp4", "write a film")
    snapshot: cli.PictureName | None = cli.option("OUT.png", "write the last frame: .png, .jpg or .webp")
    save_state: Path | None = cli.option("FILE.h5", "write the state at the end; --state FILE.h5 goes on from it")
    sound: Literal["auto", "on", "off"] = cli.option(
        None, "sound of impacts, also in the film of --record; auto: if there is a device and the package", "auto"
    )
    stats: Path | None = cli.option("OUT.json", "write timings and counts")
    record_input: Path | None = cli.option("FILE.h5", "record your input, to be replayed", one_of=INPUT)
    study: Path | None = cli.option("OUT.h5", "record the play in this file of a user study (see: vrgs.py study)")
    participant: str | None = cli.option("NAME", "--study: name of the player, by which both settings are compared")


@dataclass(kw_only=True)
class PlayOptions(SceneOptions, DisplayOptions):
    """All options of playing."""

    EXAMPLES = (
        "                                       play the ring toss in a window",
        "--body cat.ply                         drop your own splat on the table",
        "--scene my_scene.py                    play a scene file of yours (docs/writing_a_scene.md)",
        "--scene ROOM/                          play in a room that was captured (vrgs.py capture)",
        "--scene ring_toss --headless --record toss.mp4 --stats toss.json",
        "--xr --record-input play.h5            play in a headset, and keep what you do",
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
        cli.Condition(("--size",), lambda o: not o.xr, "is not for --xr: a headset says what it takes; --render-scale"),
        cli.Condition(("--stereo",), lambda o: o.headless, "belongs to --headless"),
        cli.Condition(("--host",), lambda o: o.web is not None, "belongs to --web"),
        STATE,
        cli.Condition(
            ("--sound",),
            lambda o: o.sound != "on" or o.record or not (o.headless or o.web is not None),
            "on: nothing is heard here, but in the film of --record",
        ),
        cli.Condition(("--participant",), lambda o: o.study, "belongs to --study OUT.h5"),
        PREPARATION,
    )


@contextlib.contextmanager
def open_session(options: PlayOptions) -> Iterator[Session]:
    """Open all that the options request, closed at the end. Raises BadInput before any long operation."""
    from commands.play_session import Outputs, Session
    from display.keep.keeper import Keeper
    from display.preferences import Preferences

    if options.body and "--scene" not in options.given:
        options.scene = "sandbox"
    preferences = Preferences() if options.headless else Preferences.of_user()
    replay, state = open_replay(options), open_state(options)
    scene = load_scene(options, replay)
    begin = state.settings.time if state else 0.0
    with (
        open_sound(options, preferences) as sound,
        open_display(options, scene, replay, preferences=preferences, begin=begin) as display,
        open_film(options, display) as film,
        open_recording(options) as recording,
        open_study(options, scene) as study,
        Keeper(label(options.scene), preferences) as keeper,
    ):
        start_taichi(options.arch, options.seed)
        world = {"interaction": options.interaction, "embedding": options.embedding, "sort": options.sort}
        world |= {"depth": bool(options.xr and display.depth), "fingers": bool(options.xr)}
        if replay:
            world = replay.world_options(world)
        views = {"views": 2 if options.stereo or options.xr else 1, "props": display.props() if options.xr else []}
        with Session(
            options,
            scene,
            display,
            Outputs(film, recording, study, keeper, sound),
            replay=replay,
            load=lambda changed: load_scene(changed, None),
            world_options=world | views,
            preferences=preferences,
            reserve=[asset for asset, _, _ in state.added] if state else [],
        ) as session:
            if state:
                from display.keep.scene_state import put_state

                put_state(session.world, state, str(options.state))
            if recording:
                recording.begin(options, world)
            yield session


def load_scene(options: PlayOptions, replay: Replay | None) -> Scene:
    """The scene with the options' bodies, material and room, prepared if they are splat files. Raises BadInput.

    A line says which role each of them plays.
    """
    from scenes import registry

    if options.detail == "paper":
        from scenes.paper_demos import paper_demo_of, use_paper_assets

        use_paper_assets(paper_demo_of(options.scene, options.options))
    prepared_capture(options)
    bodies, stage = prepared_bodies(options), prepared_stage(options)
    material = options.material
    if replay and material is None:
        material = replay.implied_material(options.scene, bodies[0] if bodies else None)
    resize = options.scale is None
    scene = registry.load(options.scene, body=bodies, material=material, stage=stage, resize=resize, **options.options)
    if not scene.cast:
        return scene
    files = dict(zip([*bodies, stage], [*(options.body or ()), options.stage], strict=True))
    cast = tuple((Path(files[asset]).name, role) for asset, role in scene.cast)
    print("; ".join(f"{file} is {role}" for file, role in cast), flush=True)
    return replace(scene, cast=cast)


def open_replay(options: PlayOptions) -> Replay | None:
    """The recording to be replayed, whose options replace those of the command. Raises BadInput."""
    if not options.replay:
        return None
    if options.xr:
        raise BadInput("--replay is seen in a window or with --headless: leave out --xr")
    from display.record.replay import Replay

    replay = Replay.load(options.replay)
    take_options(options, replay.about, options.replay, "recording was made")
    return replay


def open_state(options: PlayOptions) -> SceneState | None:
    """The state to go on from, whose options replace those of the command. Raises BadInput."""
    if not options.state:
        return None
    from display.keep.state_file import read_state

    path = options.state
    state = read_state(path)
    take_options(options, state.about, path, "state was saved")
    options.state = path  # not that from which its own play went on
    return state


def take_options(options: PlayOptions, about: dict[str, Any], file: Path, made: str) -> None:
    """Take the options over with which a file was `made`. Raises BadInput if the command line names others, or for a
    scene file that it does not name: it would be run."""
    from display.record.recording_file import OPTIONS

    scene = options.scene
    for key in OPTIONS:
        if key not in about:
            continue
        value = about[key]
        if key == "body" and isinstance(value, str):  # until version 2 of recordings
            value = [value]
        if f"--{key}" in options.given and key != "state" and getattr(options, key) != value:
            raise BadInput(f"--{key} {getattr(options, key)}: the {made} with {value}, which stays")
        setattr(options, key, value)
    options.options = options.options or {}  # none in old recordings
    options.arch = options.arch or about.get("arch")
    if is_scene_file(options.scene) and options.scene != scene:
        raise BadInput(f"{file}: was played in a scene file; name it too: --scene {options.scene}")


def open_recording(options: PlayOptions):
    """The recording of the user's input, or a context of None."""
    if not options.record_input:
        return contextlib.nullcontext()
    from display.record.recording import Recording

    return Recording(options.record_input)


def open_study(options: PlayOptions, scene: Scene):
    """The log of the participant's trials, or a context of None."""
    if not options.study:
        return contextlib.nullcontext()
    from display.study.study_file import StudyLog

    of_scene = " ".join(f"{key}={value}" for key, value in sorted(options.options.items()))
    shown = "window" if options.web is None else "browser"
    return StudyLog(
        options.study,
        participant=(options.participant or "").strip(),
        task=f"{label(options.scene)} {of_scene}".rstrip(),
        device="headset" if options.xr else "headless" if options.headless else shown,
        about={"options": options.options, "roles": {role: file for file, role in scene.cast}},
    )


def open_sound(options: PlayOptions, preferences: Preferences):
    """The sound of the play and of its film, or a context of None. Open it first: it ends when the film is complete."""
    heard = not options.headless and options.web is None
    if options.sound == "off" or not (heard or options.record):
        return contextlib.nullcontext()
    from display.sound.sound import Sound

    return Sound(film=options.record, heard=heard, asked=options.sound == "on", preferences=preferences)


def open_display(
    options: PlayOptions,
    scene: Scene,
    replay: Replay | None = None,
    *,
    preferences: Preferences | None = None,
    begin: float = 0.0,
) -> Display:
    """The headset, the browser, the window, or, with --headless or without a screen, the files.

    A headless play begins `begin` [s] after the scene's start.
    """
    for file in filter(None, (options.stats, options.snapshot, options.save_state)):
        check_writable(file)
    name = label(options.scene)
    title = f"VR-GS: {name}"
    if options.web is not None:
        from display.web.browser import Browser

        return Browser(
            scene,
            title=title,
            host=options.host,
            port=options.web,
            size=options.size,
            name=name,
            preferences=preferences,
        )
    if options.xr:
        from display.xr.headset import Headset

        marks = not options.record  # markers do not belong in a film
        return Headset(scene, title=title, scale=options.render_scale, marks=marks)
    if not options.headless:
        from display.window.gl_window import has_display

        if has_display():
            from display.window.window import Window

            width, height = options.size or (None, None)
            return Window(
                scene,
                title=title,
                width=width,
                height=height,
                hint=replay is None,
                preferences=preferences,
                name=name,
            )
        options.headless = True
        options.record = options.record or Path(f"{name}.mp4")
        options.snapshot = options.snapshot or Path(f"{name}.png")
        files = f"{options.record} and {options.snapshot}"
        print(f"no display: the scripted hand plays; writing {files} (--web: play in a browser)", file=sys.stderr)
    from display.headless.headless import Headless

    if options.snapshot:
        check_writable(options.snapshot)
    frames = options.frames or max(1, round(FPS * ((scene.game.duration if scene.game else SECONDS) - begin)))
    frames = min(options.frames or len(replay), len(replay)) if replay else frames
    width, height = options.size or SIZE
    return Headless(
        scene,
        width=width,
        height=height,
        frames=frames,
        views=2 if options.stereo else 1,
        scripted=replay is None,
    )


def open_film(options: PlayOptions, display: Display):
    """The film of the play, or a context of None."""
    if not options.record:
        return contextlib.nullcontext()
    from display.headless.video import FilmWriter

    seconds = display.count / FPS if options.headless and not options.replay else 0.0
    return FilmWriter(options.record, *display.size, views=2 if options.stereo else 1, seconds=seconds)
