"""`vrgs.py bench frame`: a headset's frame without a headset: ring toss in stereo, scripted hands, up to the textures.

Both eyes of 1800x1920, with the player's hands and finger contact. As in a headset, the head is located after the
simulation, at the start of drawing; the time from there until the picture is in the eyes' textures is the program's
part of the motion-to-photon latency. The runtime then waits for its next refresh, half a period on average. Times of
single stages wait for the device after each stage, which takes longer than the frame itself.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.stereo_play import EYE_SIZE, RATE, StereoPlay
from display.xr.headset import NoMirror
from display.xr.swapchains import FRAGMENT, VERTEX
from scenes import ring_toss

FRAMES = 1000
WARM_FRAMES = 2  # warm-up frames: kernels are compiled, and everything is in motion


def run() -> Iterator[dict]:
    """Measure as it runs, and stage by stage; prints and yields both rows."""
    for row in map(measure, (False, True)):
        print("stage by stage" if row["exact"] else "as it runs")
        for name, values in row["stages"].items():
            print("  {:10} {median_ms:8.2f} ms, worst {worst_ms:8.2f}".format(name, **values))
        print("  {:10} {median_ms:8.2f} ms, worst {worst_ms:8.2f} of {frames}".format("frame", **row))
        print(f"  from motion to light {row['photon_ms']:.2f} ms and {500 / RATE:.2f} on average to the next refresh")
        print(f"  pictures go to OpenGL {'through the host' if row['through_host'] else 'on the device'}")
        yield row


def measure(exact: bool) -> dict:
    """Times [ms] of FRAMES frames and their stages; with `exact` each stage waits for the device."""
    play = StereoPlay(ring_toss.build())
    opengl = NoMirror(2)
    gl, picture = opengl.gl, opengl.texture
    targets = [gl.framebuffer(color_attachments=[gl.texture(EYE_SIZE, 4)]) for _ in range(2)]
    program = gl.program(VERTEX, FRAGMENT)
    triangle = gl.vertex_array(program, [])

    def present() -> None:
        picture.upload(play.world.picture)
        picture.texture.use(0)
        for view, target in enumerate(targets):
            target.use()
            gl.viewport = (0, 0, *EYE_SIZE)
            program["rows"] = (view * EYE_SIZE[1], EYE_SIZE[1])
            triangle.render(gl.TRIANGLES, vertices=3)
        gl.finish()

    play.play(WARM_FRAMES, present)
    play.start(exact=exact)
    play.play(FRAMES, present)
    stages = play.world.timings.as_dict()
    row = {"exact": exact, "stages": stages, "frames": FRAMES, "median_ms": float(np.median(play.frame_ms))}
    row |= {"worst_ms": max(play.frame_ms), "photon_ms": float(np.median(play.photon_ms))}
    row |= {"through_host": picture.through_host}
    opengl.close()
    return row
