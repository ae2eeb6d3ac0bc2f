"""The bodies of a running world: of which of the scene's bodies each body of the solver is a copy.

An edit changes the solver's body, its Gaussians and its animation together. The first one reads back from the device
what it holds of the scene's bodies; a play without edits pays nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from core.errors import BadInput
from core.material import MATERIALS, Material
from core.rotation import pose_matrix
from core.vocabulary import BodyState, Hand
from display.device_scene import DeviceScene
from display.scene_bodies import AnimationTargets, Piece, fitted_harmonics, pieces_of
from sim.embedding import BodySpan, PackedBody
from sim.model import MAX_BODIES, BodyModel, CapacityError

FULL_NOTICE = "There is no capacity for that: remove something first."
REMOVED_X = 1e3  # [m] where the game sees a body that was removed
T = TypeVar("T")
Look = tuple[np.ndarray, np.ndarray, np.ndarray]  # see Splats.read
Source = tuple[PackedBody, Look, BodyModel]  # what a body looks like, and its model


@dataclass(frozen=True)
class Member:
    """A body of the solver: the index of the scene's body that it looks like, whether it is a copy of that, and the
    name of the material that the user gave it last."""

    source: int
    copy: bool = False
    material: str = ""


@dataclass(frozen=True)
class BodiesSnapshot:
    """State of all bodies: the solver's, the members, the animations with their times, and the assets that have joined,
    whose members' sources follow those of the scene."""

    solver: dict
    members: tuple[Member, ...]
    animations: tuple[AnimationTargets, ...]
    added: tuple[str, ...] = ()


class BodyRegistry:
    """The members, in the order of the solver's bodies, and their animations.

    An edit that fails raises BadInput and changes nothing.
    """

    def __init__(self, device: DeviceScene):
        self.device = device
        self.animations = [a.at(0.0) for a in device.animations]
        self.scene_models = device.solver.body_models
        self._scene_members = self.members = tuple(Member(k) for k in range(len(self.scene_models)))
        self._packed: list[PackedBody] | None = None
        self._looks: list[Look] = []
        self.animated = {a.body: a for a in device.animations}  # of each source that has one, at any place and time
        self.source_models = list(self.scene_models)  # of all that a body can look like: the scene's, then those added
        self.added: dict[str, list[int]] = {}  # sources of the assets that joined, after those of the scene

    @property
    def changed(self) -> bool:
        """True if any body differs from the scene's."""
        return self.members != self._scene_members or self.device.solver.body_models != self.scene_models

    def scene_states(self, bodies: list[BodyState]) -> list[BodyState]:
        """The states of the scene's own bodies, in its order: all that its game sees. A removed one is far away.

        Of a body of several pieces it is the largest.
        """
        count = sum(body.material is not None for body in self.device.scene.bodies)
        if self.members == self._scene_members:
            return bodies[:count]
        index = {m.source: k for k, m in enumerate(self.members) if not m.copy}
        return [bodies[index[k]] if k in index else self._removed(k) for k in range(count)]

    def _removed(self, k: int) -> BodyState:
        body, far = self.scene_models[k].body, np.array([REMOVED_X, 0.0, 0.0])
        up = np.array([0.0, 1.0, 0.0])
        return BodyState(body.name, far, np.zeros(3), far, far, up, False, body.pinned is not None)

    def gaussian_span(self, k: int) -> tuple[int, int]:
        """Begin and end of a body's Gaussians among the splats."""
        begins = self._begins(self.members)
        return begins[k], begins[k + 1]

    def step(self, dt: float, hands: list[Hand]) -> None:
        """Advance all bodies by dt [s]; `hands` are the poses at its end."""
        for animation in self.animations:
            animation.drive(self.device.solver, dt)
        self.device.solver.step(dt, hands)

    def rebase_animations(self) -> None:
        """Let animated bodies that were carried off while time stood still go on from where they are."""
        if self.animations and self.device.solver.interaction == "transform":
            self.animations = [a.rebased(self.device.solver) for a in self.animations]

    # edits

    def add(self, pieces: Sequence[Piece], derived: Sequence[Source] = ()) -> int:
        """Let the pieces of an asset, with what is derived of them, join; returns the index of the first."""
        sources = self.sources_of(pieces, derived)
        members = (*self.members, *(Member(source, copy=True) for source in sources))

        def add() -> int:
            if len(members) > MAX_BODIES:
                raise BadInput(f"There are {len(self.members)} bodies, as many as there can be.")
            self._check(members)
            known = [self.source_models[source] for source in sources]
            return self.device.solver.add_all([piece.body for piece in pieces], known)

        first = self._with_capacity(add)
        for k, piece in enumerate(pieces):
            self.animations += piece.targets(first + k)
        self._show(members)
        return first

    def derived(self, pieces: Sequence[Piece]) -> list[Source]:
        """The sources of pieces that the play has not seen; a thread may make them, on the host alone."""
        if pieces[0].placed.asset in self.added:
            return []
        device, result = self.device, []
        for piece in pieces:
            sh = fitted_harmonics(piece.part.gaussians, device.splats.coefficients)
            opacity = piece.part.gaussians.opacities.astype(np.float32)
            model = device.solver.derived(piece.body, self.source_models)
            result.append((device.embedding.packed(piece.part), (opacity, sh, np.ones_like(opacity)), model))
        return result

    def sources_of(self, pieces: Sequence[Piece], derived: Sequence[Source] = ()) -> list[int]:
        """Indices of what these pieces look like, which is kept on the host."""
        self._read()
        asset = pieces[0].placed.asset
        if asset not in self.added:
            device, first = self.device, len(self._packed)
            for piece, (packed, look, model) in zip(pieces, derived or self.derived(pieces), strict=True):
                self._packed.append(packed)
                self._looks.append(look)
                device.parts.append(piece.part)
                for animation in piece.targets(0):
                    self.animated[len(self.source_models)] = animation
                self.source_models.append(model)
            self.added[asset] = list(range(first, first + len(pieces)))
        return self.added[asset]

    def remove(self, k: int) -> None:
        """Remove a body."""
        self.device.solver.remove(k)
        self.animations = [a.moved(np.eye(4), a.body - (a.body > k)) for a in self.animations if a.body != k]
        self._show(self.members[:k] + self.members[k + 1 :])

    def duplicate(self, k: int, offset: np.ndarray) -> int:
        """Put a copy of a body at an offset [m] from it, (3,); returns its index."""
        members = (*self.members, replace(self.members[k], copy=True))

        def copy() -> int:
            self._check(members)
            return self.device.solver.duplicate(k, offset)

        new = self._with_capacity(copy)
        by = pose_matrix(offset, np.eye(3))
        self.animations += [a.moved(by, new) for a in self.animations if a.body == k]
        self._show(members)
        return new

    def rescale(self, k: int, factor: float, about: np.ndarray) -> None:
        """Scale a body about a point [m]."""
        self._with_capacity(lambda: self.device.solver.rescale(k, factor, about=about))
        self._move_animation(k, pose_matrix((1.0 - factor) * about, factor * np.eye(3)))

    def displace(self, k: int, by: np.ndarray, *, rest: bool = False) -> None:
        """Move a body by a rigid transform (4, 4); `rest`: it stands still then."""
        self.device.solver.displace(k, by, rest=rest)
        self._move_animation(k, by)

    def set_material(self, k: int, material: Material | str) -> None:
        """Make a body of another material, given or named."""
        given = material if isinstance(material, Material) else Material.named(str(material))
        self._with_capacity(lambda: self.device.solver.set_material(k, given))
        name = self.members[k].material if given is material else str(material)
        self._show((*self.members[:k], replace(self.members[k], material=name), *self.members[k + 1 :]))

    def material(self, k: int) -> tuple[Material, str]:
        """Material of a body, and its name: "rubber", "rubber, changed"; of a rigid body, "rigid"."""
        body = self.device.solver.body_models[k].body
        if body.rigid:
            return body.material, "rigid"
        own = self.source_models[self.members[k].source].body.material
        known = {**MATERIALS, "": own}
        base = self.members[k].material
        name = base or next((name for name, material in MATERIALS.items() if material == own), "own material")
        return body.material, name if body.material == known[base] else f"{name}, changed"

    def reset(self) -> None:
        """The scene's own bodies at their start, and no others."""
        changed = self.changed
        self.device.solver.reset(self.scene_models if changed else None)
        self.animations = [a.at(0.0) for a in self.device.animations]
        if changed:
            self._show(self._scene_members)

    def snapshot(self) -> BodiesSnapshot:
        """The state of all bodies; hands count as open."""
        self.rebase_animations()
        animations = tuple(a.at(a.time) for a in self.animations)
        return BodiesSnapshot(
            {**self.device.solver.snapshot(), "grasps": None}, self.members, animations, tuple(self.added)
        )

    def restore(self, snapshot: BodiesSnapshot) -> None:
        """Bring a state back."""
        self._with_capacity(lambda: self.device.solver.restore(snapshot.solver))
        self.animations = [a.at(a.time) for a in snapshot.animations]
        self._show(snapshot.members)

    def adopted(self, snapshot: BodiesSnapshot) -> BodiesSnapshot:
        """The snapshot of another registry of the same scene, with its animations on this device."""
        for asset in snapshot.added:
            self.sources_of(pieces_of(asset))
        own = self.animated
        animations = tuple(own[snapshot.members[a.body].source].placed_as(a) for a in snapshot.animations)
        return replace(snapshot, animations=animations)

    @property
    def guests(self) -> list[str]:
        """The assets of the bodies that have joined, one for each that is there."""
        asset_of = {sources[0]: asset for asset, sources in self.added.items()}
        return [asset_of[m.source] for m in self.members if m.source in asset_of]

    def warm_up(self) -> None:
        """Compile what the first edit needs; nothing is changed."""
        splats, first = self.device.splats, self.device.first
        if self.members:
            splats.write(first, *splats.read(first, 1))
        for animation in self.animations:
            animation.rebased(self.device.solver)

    def _move_animation(self, k: int, by: np.ndarray) -> None:
        self.animations = [a.moved(by) if a.body == k else a for a in self.animations]
        self._show(self.members)

    # capacity, and what is shown

    def _with_capacity(self, edit: Callable[[], T]) -> T:
        """The result of an edit; CapacityError with a notice for the user if there is no capacity for it."""
        try:
            return edit()
        except CapacityError as e:
            raise CapacityError(FULL_NOTICE) from e

    def _show(self, members: tuple[Member, ...]) -> None:
        """Let the picture show these members where the solver has them."""
        device, before = self.device, self._begins(self.members)
        models, vertices, begins = device.solver.body_models, device.solver.vertex_offset, self._begins(members)
        spans = [
            BodySpan(m.source, v, g, model.shape.factor)
            for m, v, g, model in zip(members, vertices, begins, models, strict=False)
        ]
        if spans != device.embedding.spans:
            self._read()
            device.show(spans, self._packed, begins[-1])
            for k, (m, g) in enumerate(zip(members, begins, strict=False)):
                if not (k < len(self.members) and self.members[k].source == m.source and before[k] == g):
                    device.splats.write(g, *self._looks[m.source])
        self.members = members

    def _check(self, members: tuple[Member, ...]) -> None:
        """Raise CapacityError if the splats or the embedding have no capacity for these members."""
        self._read()
        spans = [BodySpan(m.source, 0, 0) for m in members]
        device = self.device
        if self._begins(members)[-1] > device.splats.capacity or not device.embedding.fits(spans, self._packed):
            raise CapacityError("no capacity for Gaussians")

    def _begins(self, members: tuple[Member, ...]) -> list[int]:
        return self.device.begins(m.source for m in members)

    def _read(self) -> None:
        """Keep on the host what the device holds of each of the scene's bodies; they are shown, and no others."""
        if self._packed is None:
            splats, begins = self.device.splats, self._begins(self._scene_members)
            counts = self.device.gaussian_counts
            self._looks = [splats.read(first, count) for first, count in zip(begins, counts, strict=False)]
            self._packed = list(self.device.embedding.bodies)
