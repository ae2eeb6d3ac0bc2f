"""The panel as data: sections of rows, each with what it shows and the commands that it sends.

`Panel.sections` makes them anew from a world. Three places draw them: ImGui in the window (window/panel_drawer.py), the
page (web/page.js), and the headset, which has some of the buttons on the wrist (xr/wrist_panel.py). The menu of scenes,
which all three have too, is described at the end.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import get_args, get_type_hints

import numpy as np

from assets.room_folder import PICTURE as ROOM_PICTURE
from core.material import MATERIALS, Material
from display import user_commands
from display.protocol import WorldView
from display.timing import Timings
from display.user_commands import EDITS, MIN_TIME_SCALE, Command, Export, Film, OpenScene, PlayDemo, SetLight
from scenes import registry
from scenes.registry import Demo, SceneOption

ACCENT, QUIET = (0.98, 0.66, 0.24, 1.0), (0.66, 0.69, 0.74, 1.0)  # colours of ImGui's theme and of the wrist panel
READ_INTERVAL = 0.5  # [s] between two readings of the timings: faster ones cannot be read
RESOLUTIONS = {"Auto": None, "Full": 1.0, "3/4": 0.75, "1/2": 0.5}  # scale of a side of the picture
RESOLUTION_TIP = "Size of the drawn picture, on each side: fewer pixels are faster."
AUTO_TIP = "Fewer pixels while things move, if that is slow; all of them once they are still."
COUNTS = ("gaussians", "vertices", "tets", "substeps")  # of a world's statistics
GRAVITY_MAX = 20.0  # [m/s^2] of the slider: twice the earth's
LIGHT_RANGE = 4.0  # [m] of the light's sliders around the scene's target
INTERACTIONS = {
    "Physics": "Bodies deform, collide and fall.",
    "Transform": "A body that you hold moves rigidly; nothing deforms.",
}
EXPORT_PREFIX = "export ."
EXPORTS = tuple(EXPORT_PREFIX + kind for kind in get_args(get_type_hints(Export)["kind"]))
CAGES = ("vtu", "obj")  # exports without colours
EXPORT_TIP = (
    "ply, spz, splat, sog, glb: Gaussians as they are now. html: a page that shows them. usdz: bodies for other "
    "simulators. vtu: cages with their fields. obj: surfaces of the cages."
)
SCENE_PICTURES = Path(registry.__file__).parent / "pictures"


@dataclass(frozen=True)
class Button:
    """A button that sends `commands`; `on` is whether it is lit, and `label` stands on it then instead of its name."""

    name: str
    commands: Sequence[Command]
    tip: str = ""
    on: bool = False
    label: str = ""

    @property
    def text(self) -> str:
        """Its text now."""
        return self.label if self.on and self.label else self.name


@dataclass(frozen=True)
class ButtonGrid:
    """Buttons in rows of `columns`."""

    buttons: Sequence[Button]
    columns: int = 3


@dataclass(frozen=True)
class Choice:
    """One of several `options`: buttons side by side, or, if it is `listed`, a list that unfolds.

    options  text about each by its name: the tip of a button, what follows the name in a list
    choose   commands of a chosen option
    """

    name: str
    options: Mapping[str, str]
    current: str
    choose: Callable[[str], Sequence[Command]]
    listed: bool = False
    tip: str = ""


@dataclass(frozen=True)
class Slider:
    """A slider of a `value` from `low` to `high`, which the user reads as `shown`.

    command  of a new value, and whether that continues the last change: a drag is undone as one
    usual    value that the user can bring back
    log      equal ratios take equal ways
    """

    name: str
    value: float
    low: float
    high: float
    shown: str
    command: Callable[[float, bool], Command]
    usual: float | None = None
    log: bool = False
    tip: str = ""


@dataclass(frozen=True)
class Toggle:
    """A switch; `switch` gives the commands of turning it on or off."""

    name: str
    on: bool
    switch: Callable[[bool], Sequence[Command]]


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Table:
    """Rows of texts, the first of each row its name; `head`: the first row names the columns."""

    rows: Sequence[Sequence[str]]
    head: bool = False


Row = ButtonGrid | Choice | Slider | Toggle | Text | Table


@dataclass(frozen=True)
class Section:
    """Rows under a title; the header shows `label`, if there is one, in its place.

    folded  closed until the user opens it
    plain   without a header, always open
    """

    title: str
    rows: Sequence[Row]
    label: str = ""
    folded: bool = True
    plain: bool = False


EDIT_BUTTONS = (
    Button("Copy", [EDITS["copy"]], "A copy above it (C)."),
    Button("Remove", [EDITS["remove"]], "(Del)"),
    Button("Turn", [EDITS["turn"]], "About the vertical (, and .)."),
    Button("Smaller", [EDITS["smaller"]], "(-)"),
    Button("Larger", [EDITS["larger"]], "(+)"),
)
GIZMO_BUTTON = Button("Gizmo", [], "Handles to move, turn or scale it, then none (G).")


class Panel:
    """The panel of one display: its sections, and the choices that concern the display and not the world.

    resolution  a name of RESOLUTIONS; its `scale` of a side is None where the rate decides
    gizmo       the display has one, which shows its next kind where the button without commands is pressed
    fps         of the last reading of the timings
    """

    def __init__(self, *, gizmo: bool = False):
        self.gizmo, self.resolution, self.fps = gizmo, "Auto", 0.0
        self._export, self._selected_only, self._shadows = EXPORTS[0], False, True
        self._read = -READ_INTERVAL  # [s] when the numbers were read
        self._stages: list[tuple[str, float, float]] = []
        self._lines: list[str] = []

    @property
    def scale(self) -> float | None:
        """Scale of a side of the picture that the user has chosen; None: what keeps the rate."""
        return RESOLUTIONS[self.resolution]

    def read(self, world: WorldView) -> None:
        """Take the timings anew if the last ones could be read."""
        now = perf_counter()
        if now - self._read >= READ_INTERVAL:
            self._read, self.fps, self._stages = now, world.timings.recent_fps(), world.timings.recent()
            stats = world.stats()
            counts = [f"{stats[name]:,} {name}" for name in COUNTS if name in stats]
            self._lines = [*frame_lines(world.timings), ", ".join(counts)]

    def sections(self, world: WorldView) -> list[Section]:
        """All that this world has a use for, from top to bottom."""
        made: list[Section] = []
        if world.editable:
            made += [play_section(world), self._body_section(world), Section("World", world_sliders(world))]
        if world.light is not None:
            made.append(light_section(world))
        if world.file is not None:
            made += [file_section(world), crop_section(world)]
        return [*made, self.keep_section(world), self._performance_section()]

    def _body_section(self, world: WorldView) -> Section:
        bodies, k = world.bodies(), world.selected
        if k is None or k >= len(bodies):
            return Section("Body", [Text("Take hold of a body to change it.")], folded=False)
        listed = {name: pascals(material.young) for name, material in MATERIALS.items()}
        current = world.material(k)[1]
        material = Choice("material", listed, current, lambda name: [user_commands.SetMaterial(k, name)], listed=True)
        edits = ButtonGrid([*EDIT_BUTTONS, GIZMO_BUTTON] if self.gizmo else EDIT_BUTTONS)
        return Section("Body", [material, *material_sliders(world, k), edits], called(bodies[k].name), folded=False)

    def keep_section(self, world: WorldView) -> Section:
        """Pictures, films, states and exports."""
        filming = world.film_seconds is not None
        buttons = [
            Button("Picture", [user_commands.TakePicture()], "As a PNG, without panel and marks (F12)."),
            Button("Film", [Film(not filming)], "As an MP4, without panel and marks (F9).", filming, "End film"),
            Button("Camera", [user_commands.WriteCamera()], "As a file for vrgs.py render --camera (Shift+F12)."),
        ]
        if not world.editable:
            return Section("Keep", [ButtonGrid(buttons)])
        kind = self._export.removeprefix(EXPORT_PREFIX)
        export = Export(kind, world.selected if self._selected_only else None, self._shadows)
        buttons += [
            Button("Save", [user_commands.SaveState()], "The state of the scene (Ctrl+S)."),
            Button("Load", [user_commands.LoadState()], "Continue from the last one (Ctrl+L)."),
            Button("Export", [export], "For other programs, as chosen below (Ctrl+E)."),
        ]
        choose = partial(self._set, "_export")
        exports = Choice("export", dict.fromkeys(EXPORTS, ""), self._export, choose, listed=True, tip=EXPORT_TIP)
        rows: list[Row] = [ButtonGrid(buttons), exports]
        if world.selected is not None:
            rows.append(Toggle("selected body only", self._selected_only, partial(self._set, "_selected_only")))
        if kind not in CAGES:
            rows.append(Toggle("with shadows", self._shadows, partial(self._set, "_shadows")))
        return Section("Keep", rows)

    def _performance_section(self) -> Section:
        tips = {name: AUTO_TIP if scale is None else RESOLUTION_TIP for name, scale in RESOLUTIONS.items()}
        stages = [(name, f"{median:.2f}", f"{worst:.2f}") for name, median, worst in self._stages]
        rows: list[Row] = [Choice("resolution", tips, self.resolution, partial(self._set, "resolution"))]
        rows.append(Table([("ms", "median", "worst"), *stages], head=True))
        return Section("Performance", [*rows, *map(Text, self._lines)])

    def _set(self, name: str, value) -> list[Command]:
        """Set a choice of the display; there is no command for the world."""
        setattr(self, name, value)
        return []


def play_section(world: WorldView) -> Section:
    """Pause, step, reset, undo, the demonstration, and what a grip does."""
    buttons = [
        Button("Pause", [user_commands.Pause(not world.paused)], "(Space)", world.paused, "Resume"),
        Button("Step", [user_commands.Pause(True), user_commands.SingleStep()], "A single frame (N)."),
        Button("Reset", [user_commands.Reset()], "The scene anew (R)."),
        Button("Undo", [user_commands.Undo()], "Take the last change back (Ctrl+Z)."),
        Button("Redo", [user_commands.Redo()], "(Ctrl+Y)"),
    ]
    if world.scene.game is not None:
        buttons.append(Button("Watch", [PlayDemo(not world.demo)], "A demonstration (P).", world.demo, "Stop"))
    current = world.interaction.capitalize()
    interaction = Choice(
        "interaction", INTERACTIONS, current, lambda name: [user_commands.SetInteraction(name.lower())]
    )
    return Section("Play", [ButtonGrid(buttons), interaction], plain=True)


def material_sliders(world: WorldView, k: int) -> list[Slider]:
    """A slider for each number of body k's material; a rigid body has fewer."""
    material, name = world.material(k)

    def slider(field: str, shown_name: str, ends: tuple[float, float], shown: str, tip: str, *, log=False) -> Slider:
        def command(value: float, continued: bool) -> Command:
            return user_commands.SetMaterial(k, changed(material, field, value), continued=continued)

        return Slider(shown_name, getattr(material, field), *ends, shown, command, log=log, tip=tip)

    modulus, density = pascals(material.young), f"{material.density:,.4g} kg/m\u00b3"
    sliders = [
        slider("density", "density", (10.0, 5000.0), density, "Water has 1,000.", log=True),
        slider("friction", "friction", (0.0, 2.0), f"{material.friction:.2f}", "Coefficient: ice 0.05, rubber 1."),
    ]
    if name == "rigid":
        return sliders
    tip = "Young's modulus [Pa]: jelly 5 kPa, rubber 2 MPa."
    fading = "Rate at which vibrations lose their energy."
    strains = [] if material.yield_strain is None else [material.yield_strain]
    keeps = "Strain beyond which it keeps its new shape."
    return [
        slider("young", "stiffness", (1e3, 1e8), modulus, tip, log=True),
        *sliders,
        slider("damping", "damping", (0.0, 50.0), f"{material.damping:.1f} /s", fading),
        *(slider("yield_strain", "yields at", (0.01, 1.0), f"{s:.1%}", keeps, log=True) for s in strains),
    ]


def changed(material: Material, field: str, value: float) -> Material:
    """A material with another number; kinetic friction keeps its ratio to static friction."""
    if field == "friction" and material.kinetic_friction is not None:
        ratio = material.kinetic_friction / material.friction if material.friction > 0.0 else 1.0
        return replace(material, friction=value, kinetic_friction=ratio * value)
    return replace(material, **{field: value})


def pascals(value: float) -> str:
    """A modulus [Pa] with a prefix: "30 kPa"."""
    for factor, unit in ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa")):
        if value >= 0.9995 * factor:
            return f"{value / factor:.3g} {unit}"
    return f"{value:.3g} Pa"


def called(name: str) -> str:
    """A body's name for the user: of an asset from a file, that of the file; of a cached one, without its digest."""
    return re.sub(r"-[0-9a-f]{16}$", "", Path(name).stem).replace("_", " ")


def world_sliders(world: WorldView) -> list[Slider]:
    """Gravity and the pace of time."""
    usual = np.array(world.scene.gravity)
    direction = usual / np.linalg.norm(usual) if usual.any() else np.array([0.0, -1.0, 0.0])
    strength, pace = float(np.linalg.norm(world.gravity)), world.time_scale

    def set_gravity(value: float, continued: bool) -> Command:
        return user_commands.SetGravity(tuple((value * direction).tolist()), continued=continued)

    earth, planets = float(np.linalg.norm(usual)), "Moon 1.6, Mars 3.7, Earth 9.81, Jupiter 25."
    shown, tip = "as it is" if pace == 1.0 else f"{pace:.2g} x", "Slow motion: how fast the world's time passes."
    set_pace = user_commands.SetTimeScale
    return [
        Slider("gravity", strength, 0.0, GRAVITY_MAX, f"{strength:.2f} m/s\u00b2", set_gravity, earth, tip=planets),
        Slider("time", pace, MIN_TIME_SCALE, 1.0, shown, set_pace, 1.0, log=True, tip=tip),
    ]


def light_section(world: WorldView) -> Section:
    """The light's kind and place, and its shadow."""
    light = world.light

    def choose(name: str) -> list[Command]:
        return [SetLight(replace(light, kind=name.lower()))]

    def move(axis: int, value: float, continued: bool) -> Command:
        position = (*light.position[:axis], value, *light.position[axis + 1 :])
        return SetLight(replace(light, position=position))

    def shade(field: str, hundredths: float, continued: bool) -> Command:
        return SetLight(replace(light, **{field: hundredths / 100.0}))

    rows: list[Row] = [Choice("kind", {"Point": "", "Directional": ""}, light.kind.capitalize(), choose)]
    for axis, (name, middle) in enumerate(zip("xyz", world.scene.target, strict=True)):
        at, low, high = light.position[axis], middle - LIGHT_RANGE, middle + LIGHT_RANGE
        rows.append(Slider(name, at, low, high, f"{at:.2f} m", partial(move, axis)))
    for name, field, high, unit in (("shadow", "strength", 100.0, "%"), ("edge", "softness", 20.0, "cm")):
        value = 100.0 * getattr(light, field)
        rows.append(Slider(name, value, 0.0, high, f"{value:.3g} {unit}", partial(shade, field)))
    return Section("Light", rows)


def file_section(world: WorldView) -> Section:
    """Name and numbers of the viewed file, and how it is shown."""
    number, count = world.file_number
    buttons = [
        Button("Next file", [user_commands.NextFile()], "Tab"),
        Button("Turn up", [user_commands.TurnUp()], "The next of the file's axes points up (Y)."),
        Button("Axes", [user_commands.ShowAxes(not world.axes)], "Red x, green y, blue z; 1, 0.1 or 10 m long (X)."),
        Button("Background", [user_commands.NextBackground()], "Grey, black, white, blue (B)."),
    ]
    shown = ButtonGrid(buttons if count > 1 else buttons[1:], columns=2)
    return Section(
        "File", [Text(f"{number} of {count}: {world.file.path.name}"), shown, Table(world.file.facts)], folded=False
    )


def crop_section(world: WorldView) -> Section:
    """Sliders of a box outside of which nothing is shown, and buttons to write what is left."""
    bounds, box = world.file.bounds, world.file.crop or world.file.bounds

    def crop(side: int, axis: int, value: float, continued: bool) -> Command:
        corners = np.array([box.low, box.high])
        corners[side, axis] = value
        return user_commands.Crop(*(tuple(corner.tolist()) for corner in np.sort(corners, axis=0)))

    rows: list[Row] = []
    for axis, name in enumerate("xyz"):
        ends = float(bounds.low[axis]), float(bounds.high[axis])
        for side, (word, corner) in enumerate((("from", box.low), ("to", box.high))):
            value, command = float(corner[axis]), partial(crop, side, axis)
            rows.append(Slider(f"{name} {word}", value, *ends, f"{value:.3g} m", command, usual=ends[side]))
    everything = user_commands.Crop(tuple(bounds.low.tolist()), tuple(bounds.high.tolist()))
    buttons = [
        Button("All", [everything], "Crop nothing."),
        Button("Write", [user_commands.WriteSplats()], "What is left, as a splat file of its own (O)."),
    ]
    return Section("Crop", [*rows, ButtonGrid(buttons, columns=2)])


def font_file() -> Path:
    """Roboto, which comes with ImGui."""
    return Path(find_spec("imgui_bundle").origin).parent / "assets" / "fonts" / "Roboto" / "Roboto-Regular.ttf"


def readable(value: float) -> float:
    """A value with as many digits as one reads."""
    return float(f"{value:.3g}")


def frame_lines(timings: Timings) -> list[str]:
    """Lines about the frames: the longest, missed ones, time not simulated, and from the head's motion to light."""
    stage, seconds = max(timings.worst_stages.items(), key=lambda s: s[1], default=("", 0.0))
    cause = f" ({stage} {1e3 * seconds:.0f})" if stage else ""
    lines = [f"longest frame {1e3 * timings.worst:.0f} ms{cause}, {timings.missed:,} missed"]
    if timings.to_light is not None:
        lines.append(f"from motion to light {1e3 * timings.to_light:.0f} ms")
    if timings.dropped >= 0.1:
        lines.append(f"{timings.dropped:.1f} s left out: too slow for real time")
    return lines


def score_and_message(world: WorldView) -> tuple[str, str]:
    """Score and message of the game as they are shown; "" for a score that the message says."""
    if world.scene.game is None:
        return "", ""
    score, message = str(world.score or ""), world.message
    return "" if score in message.split() else score, message


def buttons_of(sections: Iterable[Section]) -> dict[str, Button]:
    """All buttons of sections by their names."""
    grids = [row for section in sections for row in section.rows if isinstance(row, ButtonGrid)]
    return {button.name: button for grid in grids for button in grid.buttons}


def commands_of(sections: Iterable[Section], title: str, name: str, value, continued: bool) -> Sequence[Command]:
    """Commands of a row of a section that takes a value; none where there is no such row, or it takes no such value.

    value  True of a button, a bool of a toggle, a name of a choice, a number of a slider
    """
    for row in (row for section in sections if section.title == title for row in section.rows):
        match row:
            case ButtonGrid(buttons=buttons) if value is True and name in {button.name for button in buttons}:
                return next(button.commands for button in buttons if button.name == name)
            case Choice(name=of) if of == name and isinstance(value, str) and value in row.options:
                return row.choose(value)
            case Toggle(name=of) if of == name and isinstance(value, bool):
                return row.switch(value)
            case Slider(name=of) if of == name and isinstance(value, float):
                return [row.command(readable(min(max(value, row.low), row.high)), continued)]
    return []


# The menu of scenes


@cache
def demos() -> tuple[Demo, ...]:
    """The scenes that can be played; files that are added while the program runs are not among them."""
    return tuple(demo for demo in registry.demos() if demo.build is not None)


def chosen_by_list(demo: Demo) -> list[SceneOption]:
    """The options of a scene that are one of several texts."""
    return [option for option in demo.options if option.choices]


def variants(demo: Demo) -> list[OpenScene]:
    """A scene with each choice of its first option that has some; or the scene alone."""
    options = chosen_by_list(demo)[:1]
    return [OpenScene(demo.name, {o.name: c}) for o in options for c in o.choices] or [OpenScene(demo.name)]


def spoken(name: str) -> str:
    """A scene's name as it is read: "Ring toss"."""
    return name.replace("_", " ").capitalize()


def line_of(demo: Demo) -> str:
    """The summary of a scene, without its name and what belongs to the command line."""
    return re.split(r"; | \(|, here or ", demo.summary.partition(": ")[2] or demo.summary)[0].rstrip(".")


def picture_file(request: OpenScene) -> Path | None:
    """The picture of a scene with these options, or that of the scene or captured room; None if there is none."""
    if registry.is_room(request.name):
        path = Path(request.name) / ROOM_PICTURE
        return path if path.is_file() else None
    names = ("_".join((request.name, *map(str, request.options.values()))), request.name)
    return next((path for path in (SCENE_PICTURES / f"{name}.jpg" for name in names) if path.is_file()), None)
