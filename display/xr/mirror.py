"""The headset's desktop side: a window that mirrors the left eye, or, without an X server, only an EGL context."""

from __future__ import annotations

from display.picture import PictureTexture
from display.protocol import WorldView
from display.user_commands import Command
from display.window.gl_context import EglContext
from display.window.gl_window import GLWindow, has_display
from display.window.panel.panel import Panel
from scenes.scene import Scene


class Mirror:
    """A window that shows what the left eye sees, and the panel. `gl` is its context (moderngl)."""

    egl: EglContext | None = None

    def __init__(self, scene: Scene, title: str, width: int, height: int, views: int):
        self._surface = GLWindow(title, width, height, vsync=False)  # the headset sets the rate
        self.gl = self._surface.gl
        self.texture = PictureTexture(self.gl, views=views)
        self._panel = Panel(title, self._surface.scale)

    @property
    def closing(self) -> bool:
        """True once the user has asked to close the window."""
        return self._surface.closing

    @property
    def resolution(self) -> float | None:
        """Scale of a side of the headset's pictures, as the user has chosen; None: what holds the rate."""
        return self._panel.resolution

    def show_title(self, title: str) -> None:
        """Give window and panel another title."""
        self._surface.set_title(title)
        self._panel.title = title

    def show(self, world: WorldView) -> list[Command]:
        """Draw the picture that was last uploaded, and the panel; the panel's commands."""
        self._surface.begin()
        self.texture.draw(self._surface.frame_size)
        commands = self._panel.draw(world, visible=True)
        self._surface.end()
        self._surface.swap()
        return commands

    def close(self) -> None:
        """Close the window. Further calls do nothing."""
        self._surface.close()


class NoMirror:
    """OpenGL without a window."""

    closing, resolution = False, None

    def __init__(self, views: int):
        self.egl = EglContext()
        self.gl = self.egl.gl
        self.texture = PictureTexture(self.gl, views=views)

    def show_title(self, title: str) -> None:
        """No-op."""

    def show(self, world: WorldView) -> list[Command]:
        """No-op: there is no window, and no command."""
        return []

    def close(self) -> None:
        """Destroy the context. Further calls do nothing."""
        self.egl.close()


def open_mirror(scene: Scene, title: str, size: tuple[int, int], views: int) -> Mirror | NoMirror:
    """A window where there is a screen for it, else none."""
    return Mirror(scene, title, *size, views) if has_display() else NoMirror(views)
