"""A play from its first frame to its last: the frames of a display, in one world after another."""

from __future__ import annotations

import itertools
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from assets.file_access import write_json
from commands.opening import Opening
from core.errors import BadInput, Cancelled
from core.measured_length import scale_between
from core.runtime import end_taichi, is_out_of_memory, start_taichi
from display.picture import pixels_of, save_picture, side_by_side
from display.protocol import Display, Frame
from display.timing import run_stats, start_progress
from display.user_commands import AddBody, CancelOpening, Command, Measure, OpeningCommand, OpenScene, Rescale, SwapRoom
from scenes.registry import label

if TYPE_CHECKING:
    from commands.play_options import PlayOptions
    from core.vocabulary import Light
    from display.headless.video import FilmWriter
    from display.keep.keeper import Keeper
    from display.preferences import Preferences
    from display.record.recording import Recording, Replay
    from display.sound import Sound
    from display.study.study_file import StudyLog
    from display.world import World, WorldSnapshot
    from scenes.scene import Scene


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
    load            gives the scene of such options
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
        load: Callable[[PlayOptions], Scene],
        world_options: dict,
        preferences: Preferences,
        reserve: Sequence[str] = (),
    ):
        self.options, self.display, self.replay = options, display, replay
        self.film, self.recording, self.study, self.keeper, self.sound = film, recording, study, keeper, sound
        self._load, self._world_options, self._count = load, world_options, 0
        self._opening: Opening | None = None
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
            self._planned = Planned(self.options, self._load(self.options))
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
            if not self._opening.poll():
                self.world.opening = self._opening.text
                return
            self._carry_out(self._opening)
        except BadInput as e:
            self.world.tell(str(e))
        self._opening, self.world.opening = None, ""

    def _carry_out(self, opening: Opening) -> None:
        from display.scene_bodies import load_bodies
        from sim.model import CapacityError

        match opening.request:
            case AddBody() as request:
                asset, name = opening.body(), Path(request.path).stem
                try:
                    self.world.editor.add(asset, name)
                except CapacityError:
                    self._planned = Planned(self.options, self.world.scene, (*self.world.registry.guests, asset), name)
            case OpenScene() | SwapRoom():
                scene = self._load(opening.options)
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
                self.world.editor.add(planned.reserve[-1], planned.joins)
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
        from display.keep.keeper import Remembered
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
