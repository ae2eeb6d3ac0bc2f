#!/usr/bin/env python
"""VR-GS: see a capture as Gaussians, hold it as an elastic body. The command line and the frame loop."""

from __future__ import annotations

import contextlib
import itertools
import os
import sys
from pathlib import Path

from commands.arguments import parser
from core.errors import BadInput
from core.runtime import is_out_of_memory, start_taichi


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 done, 1 a check failed, 2 bad input, 130 interrupted."""
    os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")  # before anything imports Taichi
    argv = sys.argv[1:] if argv is None else argv
    for i in range(len(argv) - 2, -1, -1):  # argparse would take the -y of `--up -y` for an option
        if argv[i] == "--up" and argv[i + 1] in ("-x", "-y", "-z"):
            argv = [*argv[:i], f"--up={argv[i + 1]}", *argv[i + 2 :]]
    args = parser(__doc__, play).parse_args(argv)
    try:
        return args.run(args) or 0
    except BadInput as e:
        print(f"vrgs: {' '.join(str(e).split())}", file=sys.stderr)
        return 2
    except (MemoryError, RuntimeError) as e:
        if not is_out_of_memory(e):
            raise
        print("vrgs: not enough memory; a smaller picture, or fewer Gaussians, need less", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("vrgs: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # `vrgs.py scenes | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def play(args) -> None:
    """Play a scene: in a window, or headless with its scripted hand."""
    from assets.library import default_material
    from scenes import registry

    replay = open_replay(args)
    body = prepared_body(args)
    material = args.material or (default_material(body) if body else None)
    scene = registry.load(args.scene, body=body, material=material, stage=prepared_stage(args))
    with (
        open_display(args, scene, replay) as display,
        open_recorder(args, display) as recorder,
        open_recording(args) as inputs,
    ):
        start_taichi(args.arch, args.seed)
        from display.run_stats import run_stats, write_stats
        from display.world import World

        width, height = display.size
        views = 2 if args.stereo or args.xr else 1
        how = {"interaction": args.interaction, "embedding": args.embedding, "sort": args.sort}
        # nobody who wears a headset should wait for room in there
        how |= {"depth": args.xr and display.depth, "fingers": bool(args.xr), "grown": bool(args.xr)}
        if replay:
            how = replay.world_options(how)
        props = display.props() if args.xr else []
        world = World(scene, width=width, height=height, views=views, props=props, **how)
        if args.headless and not replay:
            display.hands = world.scripted_hands
        if not args.headless:
            world.warm_up()
        if inputs:
            inputs.begin(args, how)
        frames = 0
        limit = None if args.headless else args.frames  # a headless display counts for itself
        given = replay.frames(display, world, paced=not args.headless) if replay else display.frames(world)
        for frame in itertools.islice(given, limit):
            world.step(inputs.note(frame) if inputs else frame)
            display.present(world)
            if recorder:
                recorder.add(world, frame.time)
            if inputs:
                inputs.after(world)
            frames += 1
        if replay:
            print(replay.report())
        if args.stats:
            write_stats(args.stats, run_stats(world, frames))
        if args.headless:
            print(f"{frames} frames, {world.timings.fps:.1f} a second; {world.message}", file=sys.stderr)


def open_replay(args):
    """What is played again, or None; the options are then those of its recording."""
    if not args.replay:
        return None
    if args.xr:
        raise BadInput("--replay is seen in a window or with --headless: leave out --xr")
    from display.record.replay import Replay

    replay = Replay.load(args.replay)
    replay.set_options(args)
    return replay


def open_recording(args):
    """What takes down the user's input, or None."""
    if not args.record_input:
        return contextlib.nullcontext()
    from display.record.recording import Recording

    return Recording(args.record_input)


def open_display(args, scene, replay=None):
    """The window, or without a display or with --headless the recorder of files."""
    if args.stats:
        from display.headless.video import claim

        claim(args.stats, args.stats.with_name(f".{args.stats.name}.part"))
    width, height = args.size
    if args.xr:
        from display.xr.headset import Headset

        marks = not args.record  # they do not belong in a film
        return Headset(scene, title=f"VR-GS: {args.scene}", scale=args.render_scale, marks=marks)
    if not args.headless:
        from display.window.gl_window import has_display

        if has_display():
            from display.window.window import Window

            return Window(scene, title=f"VR-GS: {args.scene}", width=width, height=height)
        args.headless = True
        args.record = args.record or Path(f"{args.scene}.mp4")
        args.snapshot = args.snapshot or Path(f"{args.scene}.png")
        print(f"no display: the scripted hand plays; writing {args.record} and {args.snapshot}", file=sys.stderr)
    from display.headless.headless import Headless

    frames = args.frames or (round(60 * scene.game.duration) if scene.game else 300)
    frames = min(args.frames or len(replay), len(replay)) if replay else frames
    views = 2 if args.stereo else 1
    out = {"record": args.record, "snapshot": args.snapshot}
    return Headless(scene, width=width, height=height, frames=frames, views=views, every=2, **out)


def open_recorder(args, display):
    """What films a window; a headless display films itself."""
    if args.headless or not args.record:
        return contextlib.nullcontext()
    from display.headless.film import FilmWriter

    return contextlib.closing(FilmWriter(args.record, *display.size))


def prepared_body(args) -> str | None:
    """The asset of --body: as it is if it is one already, else prepared from the splat and cached."""
    if args.body is None:
        if args.up is not None or args.scale is not None or args.pieces:
            raise BadInput("--up, --scale and --pieces belong to --body FILE")
        return None
    from assets.library import SHIPPED_FOLDER, cached_asset

    path = Path(args.body)
    if (SHIPPED_FOLDER / f"{args.body}.h5").is_file() or path.suffix.lower() == ".h5":
        return args.body
    if not path.is_file():
        raise BadInput(f"{path}: no such file")
    key = {"vertices": args.vertices, "scale": args.scale, "up": args.up}
    key |= {} if args.cells == "adaptive" else {"cells": args.cells}
    key |= {"pieces": True} if args.pieces else {}
    out = cached_asset(path, key | {"version": 2})
    if not out.is_file():
        from prepare.pipeline import Options
        from prepare.prepared_files import prepare_file

        start_taichi(args.arch, args.seed)
        print(f"preparing {path.name} (once; kept as {out})", flush=True)
        out.parent.mkdir(parents=True, exist_ok=True)
        adaptive = args.cells == "adaptive"
        options = Options(args.vertices, args.scale, args.up, adaptive=adaptive, pieces=args.pieces)
        prepare_file(path, out, options)
    return str(out)


def prepared_stage(args) -> str | None:
    """The asset of --stage: as it is if it is one already, else prepared from the splat and cached."""
    if args.stage is None or Path(args.stage).suffix.lower() == ".h5":
        return args.stage
    from assets.file_access import file_size
    from assets.library import cached_asset

    path = Path(args.stage)
    file_size(path)
    out = cached_asset(path, {"stage": 2})
    if not out.is_file():
        from prepare.prepared_files import prepare_environment_file

        start_taichi(args.arch, args.seed)
        print(f"preparing {path.name} (once; kept as {out})", flush=True)
        out.parent.mkdir(parents=True, exist_ok=True)
        prepare_environment_file(path, out)
    return str(out)


if __name__ == "__main__":
    sys.exit(main())
