"""A play opened in order: replay or state, scene, display, film, recording, study and sound, then the session."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assets.file_access import check_writable, unused_name
from commands.play_options import PlayOptions
from commands.prepared import prepared_bodies, prepared_capture, prepared_stage
from core.errors import BadInput
from core.runtime import start_taichi
from scenes.registry import is_scene_file, label

if TYPE_CHECKING:
    from commands.play_session import Session
    from display.keep.state_file import SceneState
    from display.preferences import Preferences
    from display.protocol import Display
    from display.record.recording import Replay
    from scenes.scene import Scene

EARLIER_TOYS = ("ring_red", "ball", "toy_duck")  # in the sandbox: the first in recordings up to version 4, all in 5
FPS = 60  # [1/s] of a headless play
SIZE = (960, 540)  # [px] of a headless play
SECONDS = 5  # [s] of a headless play of a scene without a game


@contextlib.contextmanager
def open_session(options: PlayOptions) -> Iterator[Session]:
    """Open all that the options request, closed at the end. Raises BadInput before any long operation."""
    from commands.play_session import Session
    from display.keep.keeper import Keeper
    from display.preferences import Preferences

    if options.body and "--scene" not in options.given:
        options.scene = "sandbox"
    preferences = Preferences() if options.headless else Preferences.of_user()
    replay, state = open_replay(options), open_state(options)
    scene = options.driven or load_scene(options, replay)
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
        world |= {"depth": bool(options.xr and display.depth), "fingers": bool(options.xr or options.driven)}
        if replay:
            world = replay.world_options(world)
        from display.xr.avatar import scripted_skins

        props = display.props() if options.xr else scripted_skins()
        views = {"views": 2 if options.stereo or options.xr else 1, "props": props}
        with Session(
            options,
            scene,
            display,
            film=film,
            recording=recording,
            study=study,
            keeper=keeper,
            sound=sound,
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
        raise BadInput("--replay plays in a window or with --headless: leave out --xr")
    from display.record.recording import Replay

    replay = Replay.load(options.replay)
    if replay.version < 6:
        replay.about = with_its_toys(replay.about, EARLIER_TOYS[: 3 if replay.version == 5 else 1])
    take_options(options, replay.about, options.replay, "recording was made")
    return replay


def open_state(options: PlayOptions) -> SceneState | None:
    """The state to go on from, whose options replace those of the command. Raises BadInput."""
    if not options.state:
        return None
    from display.keep.state_file import read_state
    from scenes.sandbox import TOYS

    path = options.state
    state = read_state(path)
    there = dict(state.assets)
    earlier = [toy for toy in EARLIER_TOYS if toy in there and TOYS[1] not in there]
    take_options(options, with_its_toys(state.about, earlier), path, "state was saved")
    options.state = path  # not that from which its own play went on
    return state


def with_its_toys(about: dict[str, Any], toys: Sequence[str]) -> dict[str, Any]:
    """The options of a play from the time when other toys lay in the sandbox, where the user brought nothing."""
    from_then = toys and about.get("scene") == "sandbox" and not about.get("body")
    return about | ({"body": list(toys)} if from_then else {})


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
            raise BadInput(f"--{key} {getattr(options, key)}: the {made} with {value}, which cannot be changed")
        setattr(options, key, value)
    options.options = options.options or {}  # none in old recordings
    options.arch = options.arch or about.get("arch")
    if is_scene_file(options.scene) and options.scene != scene:
        raise BadInput(f"{file}: was played in a scene file; name that too: --scene {options.scene}")


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
    from display.sound import Sound

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

            hint = replay is None
            return Window(scene, title=title, size=options.size, preferences=preferences, name=name, hint=hint)
        options.headless = True
        options.record = options.record or unused_name(Path(f"{name}.mp4"))
        options.snapshot = options.snapshot or unused_name(Path(f"{name}.png"))
        files = f"{options.record} and {options.snapshot}"
        print(f"no display: the scripted hand plays; writing {files} (--web: play in a browser)", file=sys.stderr)
        check_writable(options.snapshot)
    return open_headless(options, scene, replay, begin)


def open_headless(options: PlayOptions, scene: Scene, replay: Replay | None, begin: float) -> Display:
    """The display of a play without a screen: the scripted hand, or a recording, until its end or --frames."""
    from display.headless.video import Headless

    frames = options.frames or max(1, round(FPS * ((scene.game.duration if scene.game else SECONDS) - begin)))
    frames = min(options.frames or len(replay), len(replay)) if replay else frames
    if options.driven:
        frames = None
    width, height = options.size or SIZE
    return Headless(
        scene,
        width=width,
        height=height,
        frames=frames,
        views=2 if options.stereo else 1,
        scripted=replay is None and not options.driven,
    )


def open_film(options: PlayOptions, display: Display):
    """The film of the play, or a context of None."""
    if not options.record:
        return contextlib.nullcontext()
    from display.headless.video import FilmWriter

    planned = options.headless and not (options.replay or options.driven)
    seconds = display.count / FPS if planned else 0.0
    return FilmWriter(options.record, *display.size, views=2 if options.stereo else 1, seconds=seconds)
