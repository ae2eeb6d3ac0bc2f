"""Opening in a play: a scene, another room, a body. Their files are prepared first by a process, while the play goes
on; it can be cancelled at any moment, and its finished steps are kept for another time."""

from __future__ import annotations

import contextlib
import signal
import sys
from concurrent.futures import Future
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from assets.library import is_asset
from commands.options import Preparation
from commands.prepared import cached_body, cached_environment, is_prepared
from core.errors import BadInput
from core.runtime import is_out_of_memory, running_arch
from display.user_commands import AddBody, Command, OpenScene, SwapRoom

if TYPE_CHECKING:
    from commands.play_options import PlayOptions

ENDING_PATIENCE = 5.0  # [s] for a process that is asked to end


class Opening:
    """A request under way: its files are prepared one after the other. `poll` until it is ready, or `close` it.

    `options`: those of the play with the request carried out; `joining`: what is read of a body that is to be added,
    once its file is prepared. Raises BadInput for a missing file.
    """

    def __init__(self, request: Command, options: PlayOptions):
        self.request, self.options = request, opened_options(request, options)
        files = [(Path(name), False) for name in self.options.body or () if not is_asset(name)]
        if isinstance(request, AddBody) and not is_asset(request.path):
            files = [(Path(request.path), False)]
        elif self.options.stage is not None and not is_asset(self.options.stage):
            files.append((Path(self.options.stage), True))
        self._waiting = [(path, room) for path, room in files if not is_prepared(path, self.options, room=room)]
        self._now: BackgroundPreparation | None = None
        self.joining: Future | None = None

    @property
    def text(self) -> str:
        """Progress, one line."""
        return "" if self._now is None else f"{self._now.text} (Esc: cancel)"

    def poll(self) -> bool:
        """True once all files are prepared. Raises BadInput if one cannot be."""
        if self._now is not None and self._now.poll():
            self._now = None
        if self._now is None and self._waiting:
            path, room = self._waiting.pop(0)
            self._now = BackgroundPreparation(path, room=room)
        return self._now is None

    def body(self) -> str:
        """The asset of the body that is to be added."""
        path, o = self.request.path, self.options
        return path if is_asset(path) else str(cached_body(Path(path), o, o.arch, o.seed)[0])

    def close(self) -> None:
        """Give it up. Further calls do nothing."""
        if self._now is not None:
            self._now.close()


def opened_options(request: Command, options: PlayOptions) -> PlayOptions:
    """The play's options as if the request stood on the command line. Raises BadInput."""
    if isinstance(request, SwapRoom):
        return replace(options, stage=request.path)
    opened = replace(options, up=None, scale=None, front=None, vertices=None, cells="adaptive", pieces=False)
    if isinstance(request, OpenScene):
        check_name(request.name, options.scene)
        opened.scene, opened.options, opened.material = request.name, dict(request.options), None
        opened.body, opened.stage = list(request.bodies) or None, request.stage
    return opened


def check_name(name: str, playing: str) -> None:
    """Raise BadInput for a scene file that the command line did not name: it is a program, which nobody else starts."""
    from scenes import registry

    if name != playing and name not in registry.names():
        raise BadInput(f"no scene named {name!r}; there are: {', '.join(registry.names())}")


class BackgroundPreparation:
    """A process that prepares a file into the cache, as a body or as a `room`. `poll` it until it is done."""

    def __init__(self, path: Path, *, room: bool):
        self.path, self._begin = path, monotonic()
        self._step, self._problem, self._done = "", "", False
        context = get_context("spawn")  # Taichi, which this process runs, survives no fork
        self._reports, reports = context.Pipe(duplex=False)
        work = (path.absolute(), room, running_arch(), reports)
        self._process = context.Process(target=prepare_into_cache, args=work, daemon=True)
        self._process.start()
        reports.close()  # else its end would not be seen here

    @property
    def text(self) -> str:
        """Progress, one line."""
        return f"Preparing {self.path.name}: {self._step}{monotonic() - self._begin:.0f} s"

    def poll(self) -> bool:
        """True once the file is prepared. Raises BadInput if it cannot be."""
        alive = self._process.is_alive()
        with contextlib.suppress(EOFError, OSError):
            while self._reports.poll():
                kind, *said = self._reports.recv()
                match kind:
                    case "step":
                        self._step = f"{said[0]} {said[1]:.0%}, "
                    case "problem":
                        self._problem = said[0]
                    case "done":
                        self._done = True
        if alive:
            return False
        if not self._done:
            raise BadInput(self._problem or f"{self.path}: the preparation ended abnormally")
        return True

    def close(self) -> None:
        """End the process if it runs. Further calls do nothing."""
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(ENDING_PATIENCE)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()


def prepare_into_cache(path: Path, room: bool, arch: str, reports: Connection) -> None:
    """Prepare a file, in its own process; `reports` takes ("step", name, fraction), ("problem", text), ("done",)."""
    sys.stdout = None  # the summary is for a command
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the play ends this process

    def progress(step: str, done: float) -> None:
        reports.send(("step", step, done))

    try:
        if room:
            cached_environment(path, arch, progress=progress)
        else:
            cached_body(path, Preparation(), arch, progress=progress)
        reports.send(("done",))
    except BadInput as e:
        reports.send(("problem", " ".join(str(e).split())))
    except (MemoryError, RuntimeError) as e:
        if not is_out_of_memory(e):
            raise
        reports.send(("problem", f"{path}: there is not enough memory to prepare it"))
