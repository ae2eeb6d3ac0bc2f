"""watched_play.py LOG [OPTION ...]: the program itself, with the state of each frame written to LOG as a JSON line."""

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import vrgs  # noqa: E402


def watch(log) -> None:
    """Let every step of a world leave a line."""
    from display.record.command_text import NAMES
    from display.world import World

    step = World.step

    def watched(self, frame):
        step(self, frame)
        bodies = [
            {"name": b.name, "centroid": b.centroid.tolist(), "velocity": b.velocity.tolist(), "held": b.held}
            | {"size": (b.high - b.low).tolist()}
            for b in self.bodies()
        ]
        state = {"time": self.time, "score": self.score, "paused": self.paused, "bodies": bodies}
        state["hands"] = [{"position": h.position, "grip": h.grip} for h in frame.hands]
        state["touched"] = [float(abs(f).sum()) for f in self.touch_forces()]
        state["interaction"], state["commands"] = self.interaction, sorted(NAMES[type(c)] for c in frame.commands)
        state["light"] = self.light.position
        log.write(json.dumps(state) + "\n")
        log.flush()

    World.step = watched


if __name__ == "__main__":
    with open(sys.argv[1], "w", encoding="utf-8") as file:
        watch(file)
        sys.exit(vrgs.main(sys.argv[2:]))
