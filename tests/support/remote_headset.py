"""A scripted player for Monado's remote driver: a head and two controllers, sent over TCP.

The packet is `struct r_remote_data` of Monado 25.0.0 (src/xrt/drivers/remote/r_interface.h), little endian. Poses are
(x, y, z, w) quaternions and positions [m] in the play space.
"""

import contextlib
import json
import os
import socket
import struct
import tempfile
import time
from pathlib import Path

PORT = "VRGS_REMOTE_PORT"  # of the environment: where the runtime listens, another one for each that runs
VIEW = "4f4f3fI"  # field of view, pose, padding
CONTROLLER = "4f3f3f3f5f3f2f1f2f13?3x"  # pose, velocities, fingers, trigger and squeeze, stick, trackpad, buttons
PACKET = struct.Struct("<8s" + 2 * VIEW + "4f3f?3x" + 2 * CONTROLLER)
BUTTONS = ("system", "a", "b", "trigger", "thumbstick")  # each with _click and _touch
NAMES = [f"{b}_{kind}" for b in BUTTONS for kind in ("click", "touch")] + ["trackpad_touch"]


def monado() -> Path | None:
    """The JSON of a Monado that tests/support/monado.sh has built, or that VRGS_MONADO names; None without one."""
    named = os.environ.get("VRGS_MONADO")
    folder = Path(named) if named else Path.home() / ".cache" / "vrgs" / "monado"
    manifest = folder / "openxr_monado.json"
    return manifest if manifest.is_file() else None


@contextlib.contextmanager
def surroundings(*, percent: int = 20, rate: int = 15):
    """Environment in which programs find Monado with the remote driver.

    Its pictures are `percent` of full size; it draws them in software, so at a low `rate` [Hz].
    """
    with tempfile.TemporaryDirectory(prefix="monado-") as folder:
        run, port = Path(folder) / "run", free_port()
        run.mkdir(mode=0o700)
        (Path(folder) / "monado").mkdir()
        remote = {"version": 0, "port": port, "view_count": 2}
        (Path(folder) / "monado" / "config_v0.json").write_text(json.dumps({"active": "remote", "remote": remote}))
        yield {
            PORT: str(port),
            "XDG_RUNTIME_DIR": str(run),
            "XDG_CONFIG_HOME": folder,
            "XR_RUNTIME_JSON": str(monado()),
            "P_OVERRIDE_ACTIVE_CONFIG": "remote",
            "XRT_COMPOSITOR_FORCE_XCB": "1",
            "XRT_COMPOSITOR_LOG": "error",
            "XRT_COMPOSITOR_SCALE_PERCENTAGE": str(percent),
            "XRT_COMPOSITOR_DEFAULT_FRAMERATE": str(rate),
        }


def free_port() -> int:
    """A TCP port that nobody listens at now."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Controller:
    """State of one hand's controller."""

    def __init__(self, x: float):
        self.rotation, self.position = (0.0, 0.0, 0.0, 1.0), (x, 1.2, -0.3)
        self.trigger = self.squeeze = 0.0
        self.stick, self.curl = (0.0, 0.0), (0.0,) * 5
        self.pressed: set[str] = set()
        self.active, self.tracked_hand = True, False

    def packed(self) -> list:
        still = (0.0,) * 3
        fields = [*self.rotation, *self.position, *still, *still, *self.curl, self.trigger, self.squeeze, self.squeeze]
        fields += [*self.stick, 0.0, 0.0, 0.0, self.tracked_hand, self.active]
        return fields + [name in self.pressed for name in NAMES]


class Player:
    """Connected to the Monado that listens at `port`; `send` after each change."""

    def __init__(self, port: int, seconds: float = 60.0):
        end = time.monotonic() + seconds
        while True:
            try:
                self._socket = socket.create_connection(("127.0.0.1", port), timeout=10)
                break
            except OSError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.2)
        for _ in range(2):  # its first and its latest state
            self._receive()
        self.rotation, self.position = (0.0, 0.0, 0.0, 1.0), (0.0, 1.5, 0.0)
        self.left, self.right = Controller(-0.2), Controller(0.2)

    def _receive(self) -> None:
        missing = PACKET.size
        while missing:
            data = self._socket.recv(missing)
            if not data:
                raise EOFError("Monado has hung up")
            missing -= len(data)

    def send(self) -> None:
        view = [0.0] * 4 + [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0]
        fields = [b"mndrmt3\0", *view, *view, *self.rotation, *self.position, False]
        self._socket.sendall(PACKET.pack(*fields, *self.left.packed(), *self.right.packed()))

    def close(self) -> None:
        self._socket.close()
