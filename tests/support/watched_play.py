"""watched_play.py LOG [OPTION ...]: the program itself, with the state of each frame written to LOG as a JSON line."""

import json
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import vrgs  # noqa: E402

PERIOD = 1 / 25  # [s] a frame at least: what is drawn faster only costs


def watch(log) -> None:
    """Let every step of a world leave a line."""
    from display.world import World

    step = World.step
    last = [0.0]

    def watched(self, frame):
        step(self, frame)
        bodies = [
            {"name": b.name, "centroid": b.centroid.tolist(), "held": b.held, "size": (b.high - b.low).tolist()}
            for b in self.bodies()
        ]
        hands = [{"position": h.position, "grip": h.grip, "touches": len(h.touch)} for h in frame.hands]
        commands = sorted(c.key or type(c).__name__ for c in frame.commands)
        state = {"time": self.time, "paused": self.paused, "bodies": bodies, "hands": hands, "commands": commands}
        state |= {"interaction": self.interaction, "light": self.light.position}
        log.write(json.dumps(state) + "\n")
        log.flush()
        time.sleep(max(0.0, PERIOD - (time.monotonic() - last[0])))
        last[0] = time.monotonic()

    World.step = watched


if __name__ == "__main__":
    with open(sys.argv[1], "w", encoding="utf-8") as file:
        watch(file)
        sys.exit(vrgs.main(sys.argv[2:]))
