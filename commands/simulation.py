"""The module that `import vrgs` is to a Python program: it plays scenes frame by frame, headless (docs/python.md)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assets.asset import Asset, Cage
from assets.library import find_asset, is_asset
from commands.play import SIZE, load_scene, open_session
from commands.play_options import PlayOptions
from commands.prepared import prepared_bodies, prepared_stage
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from core.material import Material
from core.program import check_backend, find_home
from core.runtime import running_arch
from core.vocabulary import Body, BodyState, Box, Capsule, Hand, Light, Plane, Touch
from scenes.scene import Scene

if TYPE_CHECKING:
    import numpy as np

    from core.fields import DeviceArray
    from display.world import WorldSnapshot

__all__ = [
    "Asset", "BadInput", "Body", "BodyState", "Box", "Camera", "Capsule", "Hand", "Light", "Material", "Plane", "Scene",
    "Simulation", "Touch", "load_asset", "look_at", "perspective",
]  # fmt: skip


def load_asset(name: str | Path) -> Asset:
    """An asset by its name or file; a splat file is prepared as by --body, once. Raises BadInput."""
    find_home()
    return Asset.load(find_asset(prepared_bodies(PlayOptions(body=[str(name)]))[0]))


class Simulation:
    """A scene that the program plays: `step` it with the poses of hands, and read arrays. Use it in a `with`.

    scene    a demo's name, a captured room, a scene file (which is run), or a Scene; splat files in it are prepared
    size     of pictures [px]
    record   film to write, .mp4: complete when the simulation is closed
    arch     "cuda" or "cpu"; None: a GPU if there is one. All simulations of a process run on the same
    seed     of random numbers
    others   options of the scene, and `body`, `stage` and `material`, as on the command line

    Arrays are views of the memory in which the simulation works: NumPy arrays on the CPU, and on a GPU what torch, cupy
    and others take without a copy (core/fields.py). They change with the simulation and end with it: copy what is to be
    kept, and write to none. Raises BadInput.
    """

    def __init__(
        self,
        scene: str | Scene = "ring_toss",
        *,
        size: tuple[int, int] = SIZE,
        record: str | Path | None = None,
        arch: str | None = None,
        seed: int = 0,
        body: str | Sequence[str] | None = None,
        stage: str | None = None,
        material: str | None = None,
        **others: Any,
    ):
        find_home()
        check_backend()
        options = PlayOptions(headless=True, size=size, arch=arch, seed=seed, sound="off")
        options.record = None if record is None else Path(record)
        if isinstance(scene, Scene):
            if body or stage or material or others:
                raise BadInput("body, stage, material and options are for a scene by its name: a Scene has its own")
            options.scene, options.driven = "scene", prepared_scene(scene, options)
        else:
            bodies = [body] if isinstance(body, str) else body
            options.scene, options.body, options.stage = scene, bodies and list(map(str, bodies)), stage
            options.material, options.options = material, others
            options.driven = load_scene(options)
        with ExitStack() as stack:
            self._session = stack.enter_context(open_session(options))
            self._world, self._frames = self._session.world, self._session.frames()
            stack.callback(self._frames.close)
            stack.callback(self._free)
            if arch not in (None, running_arch()):
                raise BadInput(f"arch={arch!r}: this process computes on {running_arch()!r} already")
            self._open = stack.pop_all()
        self.camera = self._session.display.cameras[0]  # of pictures and of the film, at the scene's eye

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *error) -> None:
        self._open.__exit__(*error)

    def close(self) -> None:
        """Finish the film and free the device memory. Further calls do nothing."""
        self._open.close()

    def step(self, hands: Sequence[Hand] | None = None) -> None:
        """Simulate 1/60 s, at the end of which the hands (two at most) are there; None: the scene's scripted hand."""
        from display.headless.video import FRAME_DT

        frame = next(self._frames)
        if hands is None:
            hands = self._world.scripted_hands((round(self._world.time / FRAME_DT) + 1) * FRAME_DT)
        frame.hands, frame.cameras = list(hands), [self.camera] if self._session.film else []
        self._session.step(frame)

    def reset(self) -> None:
        """Put all bodies at their start."""
        self._world.reset()

    def snapshot(self) -> WorldSnapshot:
        """The state now, for `restore`; hands count as open."""
        return self._world.snapshot()

    def restore(self, snapshot: WorldSnapshot) -> None:
        """Go on from a state of this simulation."""
        self._world.restore(snapshot)

    @property
    def time(self) -> float:
        """Simulated time [s] since the start."""
        return self._world.time

    @property
    def bodies(self) -> list[BodyState]:
        """Each simulated body: its name, place and velocity, and whether it is held (core/vocabulary.py)."""
        return self._world.bodies()

    @property
    def game(self):
        """The scene's game, with its `score` and `message` (scenes/scene.py); None: it has none."""
        return self._world.scene.game

    @property
    def hand_forces(self) -> list[np.ndarray]:
        """Force [N] of each hand on the body that it holds, (3,)."""
        return self._world.hand_forces()

    @property
    def touch_forces(self) -> list[np.ndarray]:
        """Force [N] of each hand's finger capsules on the bodies that they push, (3,)."""
        return self._world.touch_forces()

    def cage(self, body: int) -> Cage:
        """The cage of a body at rest, in its own frame."""
        shape = self._world.device.solver.body_models[body].shape
        return Cage(shape.vertices, shape.solid, shape.surface)

    def vertices(self, body: int) -> np.ndarray | DeviceArray:
        """Vertices of a body's cage [m], (V, 3) float32, in the order of `cage`."""
        return self._view(self._world.device.solver.x, body)

    def velocities(self, body: int) -> np.ndarray | DeviceArray:
        """Velocities of a body's vertices [m/s], (V, 3) float32."""
        return self._view(self._world.device.solver.v, body)

    def gaussians(self, body: int | None = None) -> dict[str, np.ndarray | DeviceArray]:
        """The N Gaussians of a body, or all, as they are now, float32.

        means        [m], (N, 3)
        covariances  [m^2], (N, 6): xx, xy, xz, yy, yz, zz
        rotations    quaternions wxyz, (N, 4), which turn the harmonics into the world
        opacities    (N,);   visibility  of the light (N,), factor of the colour
        sh           spherical harmonics, (N, K, 3)
        """
        from core.fields import view_of

        s = self._world.device.splats
        span = (0, s.count) if body is None else self._world.registry.gaussian_span(body)
        fields = {"means": s.mean, "covariances": s.cov, "rotations": s.rotation, "opacities": s.opacity}
        fields |= {"visibility": s.visibility, "sh": s.sh}
        return {name: view_of(field, *span) for name, field in fields.items()}

    def picture(self, camera: Camera | None = None) -> np.ndarray | DeviceArray:
        """The view of a camera, or of `camera`, (H, W, 4) uint8 RGBA, valid until the next is drawn."""
        from core.fields import view_of

        self._world.draw([camera or self.camera])
        return view_of(self._world.picture)

    def export(self, path: str | Path, *, body: int | None = None) -> None:
        """Write the scene or a body as it is now: splats, a page, OpenUSD or cages, by its ending. Raises BadInput."""
        from display.keep.scene_export import exporter

        exporter(self._world, Path(path), body=body)()

    def _view(self, field, body: int) -> np.ndarray | DeviceArray:
        from core.fields import view_of

        begin = self._world.device.solver.vertex_offset
        if not 0 <= body < len(begin) - 1:
            raise IndexError(f"there is no body {body}; there are {len(begin) - 1}")
        return view_of(field, begin[body], begin[body + 1])

    def _free(self) -> None:
        from core.fields import destroy_fields
        from core.runtime import keep_compiled_kernels

        with keep_compiled_kernels():
            destroy_fields(list(vars(self._world.device).values()))


def prepared_scene(scene: Scene, options: PlayOptions) -> Scene:
    """The scene with assets in place of splat files, prepared as by --body and --stage. Raises BadInput."""
    bodies = []
    for placed in scene.bodies:
        if not is_asset(placed.asset):
            one = replace(options, body=[placed.asset], stage=placed.asset)
            asset = prepared_stage(one) if placed.material is None else prepared_bodies(one)[0]
            placed = replace(placed, asset=asset)
        bodies.append(placed)
    return replace(scene, bodies=bodies)
