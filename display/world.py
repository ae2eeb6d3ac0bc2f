"""The world of a scene: simulates, deforms, shades and draws it frame by frame, and carries out the user's commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from time import perf_counter

import numpy as np

from assets.library import with_sources
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from core.material import Material
from core.program import use_one_blas_thread
from core.vocabulary import BodyState, Hand, Light
from display import user_commands as cmd
from display.clock import SimulationCost, frame_steps
from display.device_scene import DeviceScene
from display.edit.body_registry import BodiesSnapshot, BodyRegistry
from display.edit.editor import Editor, RoomTurn, Step
from display.picture import surface_point
from display.protocol import Frame, WorldView
from display.timing import Timings
from scenes.scene import Scene
from sim.reductions import Observation

MAX_GRAVITY = 100.0  # [m/s^2] on an axis: ten times the earth's
COUNTS = ("vertices", "tets", "substeps", "dt", "integrator", "iterations", "collision_passes", "finite", "asleep")
SCRIPT_DT = 1 / 60  # [s]; a scripted hand plays in frames of this length, whatever the display's, to play alike


@dataclass(frozen=True)
class WorldSnapshot:
    """State of a running world, but for its light and its settings. backlog: `World.backlog` [s]."""

    bodies: BodiesSnapshot
    time: float
    backlog: float
    game: dict
    room: np.ndarray  # pose of the room (display/edit/editor.py)


@dataclass(frozen=True)
class Launched:
    """The simulation of a frame that the device computes: what is observed after it, its begin [s] and length [s].

    before  the editor's record of the state before it; None in a demo
    """

    observation: Observation
    begin: float
    dt: float
    before: Step | None


class World(WorldView):
    """A running scene. `step` it with each frame; then `picture` is the view of the frame's cameras.

    width, height  of one view's picture [px]
    reserve        assets of bodies for which there must be capacity, so that the editor can add them
    options        of the DeviceScene: views, interaction, embedding, sort, depth, fingers, props
    """

    editable = True

    def __init__(self, scene: Scene, *, width: int, height: int, reserve: Sequence[str] = (), **options):
        use_one_blas_thread()
        self.scene, self.reserve = scene, tuple(reserve)
        self.timings = Timings()
        self.device = DeviceScene(scene, (width, height), reserve=reserve, **options)
        self.registry = BodyRegistry(self.device)
        self.room = RoomTurn(self.device)
        self.editor = Editor(self, self.registry)
        self.paused = self.demo = self.moving = False
        self.time_scale = 1.0
        self.time = 0.0  # [s] of simulation since the last reset
        self._demo_from = self.interaction  # in which mode the demo began
        self.script_dt = SCRIPT_DT
        self.backlog = 0.0  # [s] of a demo that have passed but are not simulated yet
        self._cost = SimulationCost()
        self._hands: list[Hand] = []  # of the last frame
        self._script: list[Hand] = []  # the scripted player's hands, while it acts
        self._acting: list[Hand] = []  # as they are drawn
        self._bodies: list[BodyState] = []
        self.pictures = 0
        self.cameras: list[Camera] = []  # of the last picture
        self._drawn: tuple | None = None  # cameras of the picture; None if it is outdated
        self._commanding = self._deform_due = False  # while commands are carried out, before bodies are deformed anyway
        self._shadow_is_old = False  # what moved was not cast, which is made up for in the next frame
        filmed = any(body.filmed for body in scene.bodies)
        self._period = min((s.period for s in scene.screens if filmed), default=np.inf)  # [s] of what was filmed
        self._round, self._touched = 0, False  # how often the film has ended, and whether a hand was at a body since
        self.refresh()

    def warm_up(self) -> None:
        """Compile all kernels that a play may need, then reset the scene."""
        self.device.solver.warm_up()
        self.registry.warm_up()
        self.registry.step(SCRIPT_DT, [Hand()])
        self.reset()
        self.draw_start()
        self.stats()

    def draw_start(self) -> None:
        """Draw the view of the scene's eye."""
        width, height = self.picture_size
        view = look_at(self.scene.eye, self.scene.target)
        self.draw([perspective(width, height, self.scene.fov_y, view)] * self.device.views)

    def step(self, frame: Frame) -> None:
        """One frame: carry out commands, simulate, deform, cast shadows, draw.

        Deformation is launched behind the simulation, before that is waited for: else the device would wait for the
        host in turn. So what moved in the last frame is taken to go on moving; what begins to move is deformed late.
        """
        self._carry_out(frame.commands)
        simulates = not self.paused or cmd.last_of(cmd.SingleStep, frame.commands) is not None
        deforms = self._deform_due or (simulates and self.moving)
        launched = self._launch(frame) if simulates else None
        if self.device.show_films(self.time):
            self._drawn = None
        props_moved = self._place_props(frame.prop_poses)
        if deforms:
            self._deform(moving=not self._deform_due)
        self.moving = launched is not None and self._moved(launched)
        if self.moving and not deforms:
            self._deform(moving=True)
        elif props_moved and not deforms:
            self._shade_motion()
        if self._shadow_is_old and not self.moving and not props_moved:
            self._cast_shadow()
        self._hands = frame.hands
        if any(isinstance(c, (cmd.Settle, cmd.SaveState)) for c in frame.commands):
            self.settle()
        cameras = frame.cameras() if callable(frame.cameras) else frame.cameras
        self.draw(cameras, meanwhile=lambda: self._observe(launched))

    def _carry_out(self, commands: Sequence[cmd.Command]) -> None:
        """Carry out the frame's commands, and keep the size given to a body by two hands that have let go of it."""
        self.editor.begin_frame()
        scaled = self.device.solver.take_scaling()
        commands = [*([] if scaled is None else [cmd.Rescale(*scaled)]), *commands]
        self._commanding = True
        try:
            if commands:
                with self.timings.stage("commands"):
                    self.apply(commands)
        finally:
            self._commanding = False

    def _place_props(self, poses: np.ndarray | None) -> bool:
        """Move the skinned props, without poses to the scripted player's hands; returns whether any has moved."""
        if poses is None and self.device.props is not None and self._script != self._acting:
            from display.xr.avatar import scripted_poses

            poses, self._acting = scripted_poses(self._script, self.scene.eye, self.scene.target), self._script
        if poses is None:
            return False
        with self.timings.stage("hands"):
            return self.device.place_props(poses)

    def _launch(self, frame: Frame) -> Launched:
        """Launch the simulation of the frame."""
        if self.demo and any(hand is not None and hand.grip for hand in frame.hands):
            self._end_demo()
            frame = replace(frame, hands=[])  # open for this frame, so that they do not take over what the script holds
        before = None if self.demo else self.editor.before_step(frame.hands)
        begin = perf_counter()
        with self.timings.stage("simulate"):
            self._simulate(frame)
            return Launched(self.device.solver.observe(), begin, frame.dt, before)

    def _moved(self, launched: Launched) -> bool:
        """Wait for the simulation; returns whether anything has moved."""
        moved = launched.observation.moved
        if self.device.solver.simulated:  # time that stands still, or in which all bodies sleep, costs nothing
            self._cost.note(perf_counter() - launched.begin, launched.dt)
        return moved

    def _observe(self, launched: Launched | None) -> None:
        """Take note of where the bodies are after the simulation."""
        if launched is None:
            return
        bodies = launched.observation.bodies
        if not self.demo:
            self.editor.after_step(launched.before, self._bodies, bodies)
        self._bodies = bodies
        if self._period < np.inf:
            self._touched |= any(b.held for b in bodies) or np.any(self.touch_forces())
        if self.scene.game is not None:
            self.scene.game.update(self.time, self.registry.scene_states(bodies))

    def _simulate(self, frame: Frame) -> None:
        """Step with the user's hands at the display's pace, or with the scripted ones in frames of `script_dt`."""
        passed, script_dt = frame.dt * self.time_scale, self.script_dt * self.time_scale
        if not self.demo:
            for dt, hands in frame_steps(passed, frame.max_step, self._hands, frame.hands):
                self.registry.step(dt, hands)
            self.time += passed
            self._begin_again(frame.hands)
            return
        self.backlog += passed
        while self.backlog >= script_dt and self.demo:
            self.backlog -= script_dt
            self.time += script_dt
            self.registry.step(script_dt, self.scripted_hands(self.time))
            self._begin_again(self._script)
            if self.scene.game is None or self.time >= self.scene.game.duration:
                self._end_demo()

    def _begin_again(self, hands: Sequence[Hand]) -> None:
        """Let filmed bodies begin again with their film, of the materials that they are of now.

        After a round of the film in which a hand was at one they go on for another, so that what it did can be seen.
        """
        now = int(self.time // self._period)
        if now != self._round:
            if not self._touched and self.interaction == "physics":
                self.device.solver.reset()
                self._follow_room()
                self.registry.step(self.time - now * self._period, hands)
            self._round, self._touched = now, False

    def _deform(self, *, moving: bool = False) -> None:
        self._deform_due = False
        with self.timings.stage("embed"):
            self.device.deform()
        if moving:
            self._shade_motion()
        else:
            self._cast_shadow()

    def _shade_motion(self) -> None:
        """Cast the shadows of what moves; on a CPU, where that takes as long as a picture, in every second frame."""
        self._drawn = None
        if self._shadow_is_old or self.device.shadow is None or self.device.shadow.on_gpu:
            self._cast_shadow()
        else:
            self._shadow_is_old = True

    def _cast_shadow(self) -> None:
        self._drawn, self._shadow_is_old = None, False
        with self.timings.stage("shadow"):
            self.device.cast_shadow()

    def draw(self, cameras: Sequence[Camera], meanwhile: Callable[[], None] = lambda: None) -> None:
        """Draw for these cameras, unless the picture shows that already; `meanwhile` runs while the device draws."""
        self.cameras = list(cameras) or self.cameras
        seen = tuple((c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_camera.tobytes()) for c in cameras)
        if not cameras or seen == self._drawn:
            meanwhile()
            return
        with self.timings.stage("render"):
            self.device.render(cameras)
            meanwhile()
            self.device.finish(cameras)
        self._drawn = seen
        self.pictures += 1

    # commands

    def apply(self, commands: Sequence[cmd.Command]) -> None:
        """Carry out the commands of a frame, in the order of display/user_commands.py."""
        demo = cmd.last_of(cmd.PlayDemo, commands)
        begins, resets = demo is not None and demo.on, cmd.last_of(cmd.Reset, commands) is not None
        if begins:
            self.demo, self._demo_from, self.paused = True, self.interaction, False
        elif demo is not None or resets:
            self._end_demo()
        load = cmd.last_of(cmd.LoadState, commands)
        if load is not None:
            self.load_state(load.path)
        if begins or resets:  # a script begins at the beginning
            self.editor.record("reset")
            self.reset()
        for command in cmd.in_order(commands):
            match command:
                case cmd.SetLight(light) if self.light is not None:
                    self.editor.record("light")
                    self.set_light(light)
                case cmd.SetGravity(gravity, continued):
                    self.editor.record("gravity", continued)
                    self.set_gravity(gravity)
                case cmd.SetTimeScale(scale, continued):
                    self.editor.record("time_scale", continued)
                    self.set_time_scale(scale)
                case cmd.SetInteraction(mode):
                    self._set_interaction(mode)
                case cmd.Pause(on):
                    self.paused = on
        self.editor.apply(commands)

    def _end_demo(self) -> None:
        """Let the user's hands play again, in the mode in which they did."""
        if self.demo:
            self.demo, self._script = False, []
            self._set_interaction(self._demo_from)

    def _set_interaction(self, mode: str) -> None:
        self.registry.rebase_animations()
        self.device.solver.interaction = mode

    def reset(self) -> None:
        """Put the scene's own bodies at their start, remove all others, and restart the game."""
        if self.registry.changed:
            self.editor.selected = None
        self.registry.reset()
        self._follow_room()
        self.time = self.backlog = 0.0
        self._round, self._touched = 0, False
        if self.scene.game is not None:
            self.scene.game.reset()
        self.refresh()

    def _follow_room(self) -> None:
        """Move bodies that are at their start with the room: the start is a place in it."""
        if self.room.moved:
            for k in range(len(self.registry.members)):
                self.registry.displace(k, self.room.pose)

    def refresh(self) -> None:
        """Read the bodies again after an edit; the next picture shows them."""
        self._bodies = self.device.solver.bodies()
        self._deform_due = True
        if not self._commanding:
            self._deform()

    def set_light(self, light: Light) -> None:
        """Replace the light."""
        self.device.set_light(light)
        self._cast_shadow()

    def set_gravity(self, gravity: tuple[float, float, float]) -> None:
        """Let bodies fall with another acceleration [m/s^2]; it wakes those that sleep."""
        self.device.solver.gravity = tuple(float(np.clip(g, -MAX_GRAVITY, MAX_GRAVITY)) for g in gravity)

    def set_time_scale(self, scale: float) -> None:
        """Slow time down; 1 is real time."""
        self.time_scale = float(np.clip(scale, cmd.MIN_TIME_SCALE, 1.0))

    def settle(self) -> None:
        """Continue as if this state had been saved and loaded: warm starts of contacts are dropped, grips are kept."""
        self.registry.rebase_animations()
        self.device.solver.restore(self.device.solver.snapshot())

    def load_state(self, path: str | Path) -> None:
        """Load a saved state, which can be undone; a notice says why if that fails."""
        from display.keep.scene_state import put_state
        from display.keep.state_file import read_state

        try:
            if not path:
                raise BadInput("No state of this scene was saved yet.")
            state = read_state(path)
            self.editor.edit("load", lambda: put_state(self, state, str(path)))
            self.tell(f"Goes on from {path}")
        except BadInput as e:
            self.tell(str(e))

    def snapshot(self) -> WorldSnapshot:
        """The state now; hands count as open."""
        game = {} if self.scene.game is None else deepcopy(vars(self.scene.game))
        return WorldSnapshot(self.registry.snapshot(), self.time, self.backlog, game, self.room.pose)

    def restore(self, snapshot: WorldSnapshot) -> None:
        """Restore a state; a demo ends."""
        self._end_demo()
        self.registry.restore(snapshot.bodies)
        self.room.place(snapshot.room)
        self.time, self.backlog = snapshot.time, snapshot.backlog
        self._round, self._touched = int(self.time // self._period), True  # it goes on as it was
        if self.scene.game is not None:
            vars(self.scene.game).update(deepcopy(snapshot.game))
        self.refresh()

    def adopt(self, snapshot: WorldSnapshot) -> None:
        """Take over the state of another world of the same scene, which may be closed."""
        self.restore(replace(snapshot, bodies=self.registry.adopted(snapshot.bodies)))

    def close(self) -> None:
        """Free the device memory, even if something still refers to this world, which cannot be used any more."""
        del self.device, self.registry, self.editor, self.room

    def scripted_hands(self, time: float) -> list[Hand]:
        """Hands of the scene's scripted player at `time` [s]."""
        game = self.scene.game
        if game is None:
            return []
        if hasattr(game, "interaction") and game.interaction(time) != self.interaction:
            self.apply([cmd.SetInteraction(game.interaction(time))])
        self._script = game.hands(time, self.registry.scene_states(self._bodies))
        return self._script

    # The view of displays, as WorldView says (display/protocol.py)

    picture_size = property(attrgetter("device.picture_size"))
    picture = property(attrgetter("device.renderer.picture"))
    light = property(attrgetter("device.light"))
    interaction = property(attrgetter("device.solver.interaction"))
    gravity = property(attrgetter("device.solver.gravity"))
    selected = property(attrgetter("editor.selected"))
    recently_selected = property(attrgetter("editor.recently_selected"))
    notice = property(attrgetter("editor.notice.shown"))
    simulation_cost = property(attrgetter("_cost.value"))

    def resize(self, width: int, height: int) -> None:
        self._drawn = None
        self.device.resize(width, height)

    def material(self, body: int) -> tuple[Material, str]:
        return self.registry.material(body)

    @property
    def softened(self) -> list[tuple[str, float, float]]:
        """Bodies simulated softer than their material: name, its Young's modulus and the simulated one [Pa]."""
        models = self.device.solver.body_models
        both = [(m.body.name, m.body.material.young, m.material.young) for m in models if not m.body.rigid]
        return [limit for limit in both if limit[2] < limit[1]]

    def rest_size(self, body: int) -> tuple[np.ndarray, float]:
        """Extents (3,) [m] and volume [m^3] of a body at rest, in its own frame."""
        model = self.device.solver.body_models[body]
        return np.ptp(np.asarray(model.body.vertices), axis=0), float(np.sum(model.shape.vertex_volumes))

    def bodies(self) -> list[BodyState]:
        return self._bodies

    def pick(self, origin, direction) -> tuple[float, int] | None:
        hit = self.device.solver.pick(origin, direction)
        return None if hit is None or self.device.sight.hides(origin, direction, hit[0]) else hit

    def surface(self, camera: Camera, u: float, v: float) -> np.ndarray | None:
        return surface_point(self.device.splats, camera, u, v)

    def ground(self, point) -> float | None:
        return self.device.sight.ground(point)

    @property
    def room_middle(self) -> np.ndarray | None:
        return self.room.middle if self.room.own is not None else None

    def tell(self, text: str) -> None:
        self.editor.notice.tell(with_sources(text))

    def hand_forces(self) -> list[np.ndarray]:
        return self.device.solver.hand_forces()

    def touch_forces(self) -> list[np.ndarray]:
        return self.device.solver.touch_forces()

    @property
    def score(self) -> int:
        return self.scene.game.score if self.scene.game is not None else 0

    @property
    def message(self) -> str:
        return self.scene.game.message if self.scene.game is not None else ""

    def stats(self) -> dict:
        """Counts and state for panels and `--stats`, and the files that play roles."""
        s = self.device.solver.stats
        counts = {"gaussians": self.device.splats.count, **{n: s[n] for n in COUNTS}, "score": self.score}
        limits = [{"body": body, "young": young, "simulated": simulated} for body, young, simulated in self.softened]
        roles = {"roles": {role: file for file, role in self.scene.cast}} if self.scene.cast else {}
        return {**counts, "softened": limits, **roles}


def softened_note(softened: Sequence[tuple[str, float, float]]) -> str:
    """A line on bodies that are simulated softer than their material, as `World.softened` lists them."""
    each = sorted({*softened})
    bodies = "; ".join(f"{body}: {simulated:.2g} Pa instead of {young:.2g}" for body, young, simulated in each)
    return f"simulated softer than their material, which would need too short substeps: {bodies}"
