"""Opening in a play: a scene, another room, a body. Files are prepared first, while the play goes on."""

from __future__ import annotations

import argparse
import copy
from pathlib import Path

from commands.background import BackgroundPreparation
from commands.prepared import is_asset, is_prepared, prepared_body
from core.errors import BadInput
from display.user_commands import AddBody, Command, OpenScene, SwapRoom

PREPARATION = {"up": None, "front": None, "scale": None, "vertices": None, "cells": "adaptive", "pieces": False}


class Opening:
    """A request under way: its files are prepared one after the other. `poll` until it is ready, or `close` it.

    `args` are the command's options with which the request is carried out. Raises BadInput for a file that there is
    not.
    """

    def __init__(self, request: Command, args: argparse.Namespace):
        self.request, self.args = request, opened_args(request, args)
        files = [(Path(name), False) for name in self.args.body or () if not is_asset(name)]
        if isinstance(request, AddBody) and not is_asset(request.path):
            files = [(Path(request.path), False)]
        elif self.args.stage is not None and not is_asset(self.args.stage):
            files.append((Path(self.args.stage), True))
        self._waiting = [(path, room) for path, room in files if not is_prepared(path, self.args, room=room)]
        self._now: BackgroundPreparation | None = None

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
        path = self.request.path
        return path if is_asset(path) else prepared_body(Path(path), self.args, None)[0]

    def close(self) -> None:
        """Give it up. Further calls do nothing."""
        if self._now is not None:
            self._now.close()


def opened_args(request: Command, args: argparse.Namespace) -> argparse.Namespace:
    """The command's options as if the request stood on the command line. Raises BadInput."""
    args = copy.copy(args)
    match request:
        case SwapRoom(path):
            args.stage = path
        case AddBody():
            vars(args).update(PREPARATION)
        case OpenScene(name, options, bodies, stage):
            check_name(name, args.scene)
            vars(args).update(PREPARATION, scene=name, options=dict(options), material=None)
            args.body, args.stage = list(bodies) or None, stage
    return args


def check_name(name: str, playing: str) -> None:
    """Raise BadInput for a scene file that the command line did not name: it is a program, which nobody else starts."""
    from scenes import registry

    if name != playing and name not in registry.names():
        raise BadInput(f"no scene named {name!r}; there are: {', '.join(registry.names())}")
