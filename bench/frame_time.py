"""`vrgs.py bench frame`: a headset's frame without a headset: ring toss in stereo, scripted hands, up to the textures.

Both eyes of 1800x1920, with the player's hands and finger contact. As in a headset, the head is located after the
simulation, at the start of drawing; the time from there until the picture is in the eyes' textures is the program's
part of the motion-to-photon latency. The runtime then waits for its next refresh, half a period on average. Times of
single stages wait for the device after each stage, which takes longer than the frame itself.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from core.camera import Camera, look_at
from display.protocol import Frame, Reset
from display.run_stats import write_stats
from display.timing import Timings
from display.world import World
from display.xr import avatar
from display.xr.actions import Controller
from display.xr.mirror import NoMirror
from display.xr.swapchains import FRAGMENT, VERTEX
from scenes import ring_toss

EYE_SIZE = (1800, 1920)  # [px] of an eye
APART = 0.064  # [m] between the eyes
RATE = 90.0  # [Hz]
FRAMES = 1000
WARM_FRAMES = 2  # warm-up frames: kernels are compiled, and everything is in motion


def run(args) -> None:
    """Run the command: measure, print a table, write --json."""
    rows = [measure(exact) for exact in (False, True)]
    for row in rows:
        print("stage by stage" if row["exact"] else "as it runs")
        for name, values in row["stages"].items():
            print("  {:10} {median_ms:8.2f} ms, worst {worst_ms:8.2f}".format(name, **values))
        print("  {:10} {median_ms:8.2f} ms, worst {worst_ms:8.2f} of {frames}".format("frame", **row))
        print(f"  from motion to light {row['photon_ms']:.2f} ms and {500 / RATE:.2f} on average to the next refresh")
        print(f"  pictures go to OpenGL {'through the host' if row['through_host'] else 'on the device'}")
    if args.json:
        write_stats(args.json, rows)


def eyes(k: int) -> list[Camera]:
    """Both eyes of a head that sways."""
    scene = ring_toss.build()
    sway = np.array([0.05 * np.sin(0.02 * k), 0.02 * np.sin(0.013 * k), 0.0])
    cameras = []
    for side in (-0.5, 0.5):
        eye = np.asarray(scene.eye) + sway + [side * APART, 0.0, 0.0]
        view = look_at(eye, np.asarray(scene.target) + [side * APART, 0.0, 0.0])
        cameras.append(
            Camera(*EYE_SIZE, 0.55 * EYE_SIZE[0], 0.55 * EYE_SIZE[0], EYE_SIZE[0] / 2, EYE_SIZE[1] / 2, view)
        )
    return cameras


def controllers(k: int) -> list[Controller]:
    """Both hands in front of the player, in motion."""
    result = []
    for side in (-1, 1):
        c = Controller()
        c.grip = np.eye(4)
        c.grip[:3, 3] = 0.2 * side + 0.03 * np.sin(0.05 * k), 1.1 + 0.05 * np.sin(0.07 * k), -0.4
        c.aim = c.grip
        result.append(c)
    return result


def measure(exact: bool) -> dict:
    """Times [ms] of FRAMES frames and their stages; with `exact` each stage waits for the device."""
    scene = ring_toss.build()
    how = {"fingers": True, "props": avatar.skins()}
    world = World(scene, width=EYE_SIZE[0], height=EYE_SIZE[1], views=2, **how)
    world.warm_up()
    opengl = NoMirror(2)
    gl, picture = opengl.gl, opengl.texture
    targets = [gl.framebuffer(color_attachments=[gl.texture(EYE_SIZE, 4)]) for _ in range(2)]
    program = gl.program(VERTEX, FRAGMENT)
    triangle = gl.vertex_array(program, [])
    frames, photon, located = [], [], [0.0]
    for k in range(WARM_FRAMES + FRAMES):

        def cameras(k=k) -> list[Camera]:
            located[0] = perf_counter()
            return eyes(k)

        if k == WARM_FRAMES:
            world.timings = Timings(exact=exact)
        begin = perf_counter()
        poses = avatar.hidden()
        for h, c in enumerate(controllers(k)):
            avatar.show_hand(poses, h, c, np.eye(4), 0.0)
        commands = [Reset()] if world.time > scene.game.duration else []
        hands = world.scripted_hands(world.time)
        world.step(Frame(1 / RATE, k / RATE, cameras, hands, commands, prop_poses=poses))
        with world.timings.stage("present"):
            picture.upload(world.picture)
            picture.texture.use(0)
            for view, target in enumerate(targets):
                target.use()
                gl.viewport = (0, 0, *EYE_SIZE)
                program["rows"] = (view * EYE_SIZE[1], EYE_SIZE[1])
                triangle.render(gl.TRIANGLES, vertices=3)
            gl.finish()
        end = perf_counter()
        if k >= WARM_FRAMES:
            frames.append(1e3 * (end - begin))
            photon.append(1e3 * (end - located[0]))
    stages = world.timings.as_dict()
    row = {"exact": exact, "stages": stages, "frames": FRAMES, "median_ms": float(np.median(frames))}
    row |= {"worst_ms": max(frames), "photon_ms": float(np.median(photon)), "through_host": picture.through_host}
    opengl.close()
    return row
