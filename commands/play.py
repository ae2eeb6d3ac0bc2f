"""A play: opened in order, replay or state, scene, display, film, recording, study and sound; then from its first frame
to its last, in one world after another."""

from __future__ import annotations

import contextlib
import itertools
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from assets.file_access import check_writable, unused_name, write_json
from commands.opening import Opening
from commands.play_options import PlayOptions
from commands.prepared import prepared_bodies, prepared_capture, prepared_stage
from core.errors import BadInput, Cancelled
from core.measured_length import scale_between
from core.runtime import end_taichi, is_out_of_memory, start_taichi
from display.keep.keeper import Keeper, Remembered
from display.picture import pixels_of, save_picture, side_by_side
from display.preferences import Preferences
from display.protocol import Display, Frame
from display.timing import run_stats, start_progress
from display.user_commands import AddBody, CancelOpening, Command, Measure, OpeningCommand, OpenScene, Rescale, SwapRoom
from scenes.registry import is_scene_file, label

if TYPE_CHECKING:
    from core.vocabulary import Light
    from display.headless.video import FilmWriter
    from display.keep.state_file import SceneState
    from display.record.recording import Recording, Replay
    from display.sound import Sound
    from display.study.study_file import StudyLog
    from display.world import World, WorldSnapshot
    from scenes.scene import Scene

EARLIER_TOYS = ("ring_red", "ball", "toy_duck")  # in the sandbox: the first in recordings up to version 4, all in 5
FPS = 60  # [1/s] of a headless play
SIZE = (960, 540)  # [px] of a headless play
SECONDS = 5  # [s] of a headless play of a scene without a game


@contextlib.contextmanager
def open_session(options: PlayOptions) -> Iterator[Session]:
    """Open all that the options request, closed at the end. Raises BadInput before any long operation."""
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


def load_scene(options: PlayOptions, replay: Replay | None = None) -> Scene:
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


@dataclass(frozen=True)
class Planned:
    """A world that is to replace the present one.

    options   as if the world had been asked for on the command line
    reserve   assets of bodies for which it must have capacity
    joins     name of the last of `reserve`, a body that joins the present state; "": the scene begins anew
    """

    options: PlayOptions
    scene: Scene
    reserve: tuple[str, ...] = ()
    joins: str = ""


class Session:
    """The world, its display and its outputs. Use it in a `with`, which ends what is being opened.

    options         of the command, which change with the scene
    film ... sound  outputs; None: not wanted
    world_options   of a World, besides its size
    reserve         assets of bodies for which the first world has capacity
    """

    def __init__(
        self,
        options: PlayOptions,
        scene: Scene,
        display: Display,
        *,
        film: FilmWriter | None,
        recording: Recording | None,
        study: StudyLog | None,
        keeper: Keeper,
        sound: Sound | None,
        replay: Replay | None,
        world_options: dict,
        preferences: Preferences,
        reserve: Sequence[str] = (),
    ):
        self.options, self.display, self.replay = options, display, replay
        self.film, self.recording, self.study, self.keeper, self.sound = film, recording, study, keeper, sound
        self._world_options, self._count = world_options, 0
        self._opening: Opening | None = None
        self._reader = ThreadPoolExecutor(1)  # of bodies that join
        self._requests: deque[Command] = deque()  # what is opened after that
        self._planned: Planned | None = None
        self._preferences = preferences
        self.world = self._make(scene, reserve)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error) -> None:
        self._end_opening()
        if not any(error):
            self._memory.keep(self.world)

    def frames(self) -> Iterator[Frame]:
        """The display's frames, or the recorded ones, as many as wanted; noted by the recording."""
        for frame in itertools.islice(self._frames(), None if self.options.headless else self.options.frames):
            frame = self._memory.given(frame, self.world)
            yield frame if self.recording is None else self.recording.note(frame)
            self._count += 1

    def step(self, frame: Frame) -> None:
        """Simulate, deform, shade and draw a frame, show it, and add it to all outputs."""
        world = self.world  # the user may open another scene
        world.step(frame)
        self.display.present(world)
        if self.film:
            self.film.add(world, frame.time)
        if self.recording:
            self.recording.after(world)
        if self.study:
            self.study.after(frame, world)
        self.keeper.after(frame, world)
        if self.sound:
            self.sound.after(frame, world)

    def report(self) -> None:
        """Print and write the results of the play."""
        options, world = self.options, self.world
        if self.replay:
            print(self.replay.report())
        if options.save_state:
            from display.keep.scene_state import state_of
            from display.keep.state_file import write_state

            write_state(options.save_state, state_of(world, self._about()))
        if options.stats:
            web = {} if options.web is None else {"web": self.display.stats()}
            write_json(options.stats, run_stats(world, self._count) | web)
        if options.snapshot:
            views = 2 if options.stereo else 1  # of a headset's the left one
            pixels = pixels_of(world.picture)[: views * world.picture_size[1]]
            save_picture(options.snapshot, side_by_side(pixels, views))
        if options.headless:
            print(f"{self._count} frames, {world.timings.fps:.1f} a second; {world.message}", file=sys.stderr)

    def _frames(self) -> Iterator[Frame]:
        """Frames of each world, without the commands that ask for another one, which are carried out here."""
        while True:
            frames = self.display.frames(self.world)
            if self.replay:
                frames = self.replay.frames(self.display, self.world, paced=not self.options.headless)
            for frame in frames:
                requests = [c for c in frame.commands if isinstance(c, OpeningCommand)]
                frame.commands = [c for c in frame.commands if not isinstance(c, OpeningCommand)]
                yield frame
                for request in requests:
                    self._take(request)
                self._advance_opening()
                if self._planned is not None:
                    break
            else:
                return
            frames.close()
            del frame, frames  # which refer to the world
            self._replace_world()

    def _take(self, request: Command) -> None:
        """Begin to open what the user asks for."""
        outputs = {"a recording": self.recording, "a study": self.study, "a replay": self.replay}
        running = next((name for name, output in outputs.items() if output is not None), None)
        if isinstance(request, CancelOpening):
            if self._opening is not None:
                self.world.tell("Cancelled.")
            self._end_opening()
        elif running is not None:  # its file names one scene, with which it begins
            self.world.tell(f"Nothing else can be opened during {running}.")
        elif isinstance(request, Measure):
            self._measure(request)
        else:
            if not isinstance(request, AddBody):  # which waits for its turn
                self._end_opening()
            self._requests.append(request)

    def _measure(self, request: Measure) -> None:
        """Scale the body that has both points, or else the room, in its file, in which the scene begins anew."""
        from display.edit.editor import body_with
        from display.keep.kept_frame import room_writer

        try:
            factor = scale_between(request.start, request.end, request.length)
            k = body_with([np.array(request.start), np.array(request.end)], self.world.bodies())
            if k is not None:
                self.world.apply([Rescale(k, factor)])
                self.world.tell(f"{factor:.3g} times as large. Ctrl+K keeps that in its file.")
                return
            if self.world.room.own is None:
                raise BadInput("Both points on one body set its size; a room must be your own (--stage) for that.")
            path, write = room_writer(self.world, factor)
            write()
            print(f"{path}: {factor:.3g} times as large", file=sys.stderr, flush=True)
            self._planned = Planned(self.options, load_scene(self.options))
        except (BadInput, OSError) as e:
            self.world.tell(" ".join(str(e).split()))

    def _end_opening(self) -> None:
        """Give up what is being opened, and what waits."""
        if self._opening is not None:
            self._opening.close()
        self._opening, self.world.opening = None, ""
        self._requests.clear()

    def _advance_opening(self) -> None:
        """Go on with what is being opened; once it is ready, add the body, or plan another world."""
        try:
            if self._opening is None and self._requests:
                self._opening = Opening(self._requests.popleft(), self.options)
            if self._opening is None:
                return
            if not self._opening.poll() or not self._is_read(self._opening):
                self.world.opening = self._opening.text
                return
            self._carry_out(self._opening)
        except BadInput as e:
            self.world.tell(str(e))
        self._opening, self.world.opening = None, ""

    def _is_read(self, opening: Opening) -> bool:
        """True once a body that is to be added has been read, on a thread: it takes longer than a frame."""
        if isinstance(opening.request, AddBody) and opening.joining is None:
            editor, name = self.world.editor, Path(opening.request.path).stem
            opening.joining = self._reader.submit(lambda: editor.prepared(opening.body(), name))
        return opening.joining is None or opening.joining.done()

    def _carry_out(self, opening: Opening) -> None:
        from display.scene_bodies import load_bodies
        from sim.model import CapacityError

        match opening.request:
            case AddBody() as request:
                try:
                    self.world.editor.add(opening.joining.result())
                except CapacityError:
                    asset, name = opening.body(), Path(request.path).stem
                    self._planned = Planned(self.options, self.world.scene, (*self.world.registry.guests, asset), name)
            case OpenScene() | SwapRoom():
                scene = load_scene(opening.options)
                load_bodies(scene)  # a file that cannot be used is found while the present world still plays
                self._planned = Planned(opening.options, scene)

    def _replace_world(self) -> None:
        """Make the planned world in place of the present one; if that fails, the present one again."""
        planned, self._planned = self._planned, None
        before = self.options, self.world.scene, self.world.reserve
        state = self.world.snapshot(), self.world.light, self.world.paused
        self._memory.keep(self.world)
        self.world.close()
        problem = ""
        try:
            self._remake(planned.options, planned.scene, planned.reserve, begins=not planned.joins)
        except Cancelled as e:
            if e.quits:
                raise
            problem = "Cancelled."
        except BadInput as e:
            problem = str(e)
        except (MemoryError, RuntimeError) as e:
            if not is_out_of_memory(e):
                raise
            problem = "There is not enough memory for that."
        if problem:
            self._remake(*before, begins=not planned.joins)
            self._resume(*state)
            self.world.tell(problem)
        elif planned.joins:
            self._resume(*state)
            try:
                editor = self.world.editor
                editor.add(editor.prepared(planned.reserve[-1], planned.joins))
            except BadInput as e:
                self.world.tell(str(e))

    def _resume(self, snapshot: WorldSnapshot, light: Light | None, paused: bool) -> None:
        self.world.adopt(snapshot)
        self.world.paused = paused
        if light is not None:
            self.world.set_light(light)

    def _remake(self, options: PlayOptions, scene: Scene, reserve: Sequence[str], *, begins: bool) -> None:
        """Start Taichi anew, and in it this world: so the device has all its memory back, and kernels, whose names in
        the cache count the fields before theirs, are found there."""
        end_taichi()
        start_taichi(options.arch, options.seed)
        self.options = options
        if begins:  # else the view stays
            name = label(options.scene)
            self.display.show_scene(scene, f"VR-GS: {name}", name)
        self.world = self._make(scene, reserve)

    def _about(self) -> dict:
        """The options that make the world, for a state."""
        from display.record.recording import about_play

        return about_play(self.options, self._world_options)

    def _make(self, scene: Scene, reserve: Sequence[str]) -> World:
        """The world of a scene, ready to play, with a report of the progress."""
        from display.world import World, softened_note

        name, options = label(self.options.scene), self.options
        self.keeper.scene, self.keeper.about = name, self._about
        users_light = not (options.headless or self.replay or options.state)  # else the script or the file says it
        self._memory = Remembered(self._preferences, name, light=users_light)
        width, height = self.display.size
        with start_progress(self.display.loading):
            world = World(scene, width=width, height=height, reserve=reserve, **self._world_options)
            world.draw_start()
            self.display.loading("", world.picture)
            world.warm_up()
        if world.softened:
            print(softened_note(world.softened), file=sys.stderr, flush=True)
        return world
