"""The command line: each option acts or is refused in one line, before anything is read or started."""

import signal
import time
from typing import get_args

import pytest

import vrgs
from commands.options import Sort
from commands.parser import COMMANDS, command_parser, parse, playing_parser, scene_file_in
from core.errors import BadInput
from render import SORTS

ALWAYS = {  # options that act whatever else is given; scenes check their own
    None: "--help --version --web --scene --xr --headless --arch --interaction --embedding --sort --frames --record"
    " --snapshot --stats --save-state --record-input --replay --study --seed --body --stage --material --detail",
    "scenes": "--help",
    "export": "--help --scene --arch --interaction --embedding --frames --seed --body --stage --material --detail"
    " --replay --out --only",
    "view": "--help --arch --background --size --snapshot --sort --up",
    "render": "--help --antialias --arch --camera --out --sort --turntable",
    "prepare": "--help --arch --out",
    "convert": "--help",
    "train": "--help --arch --out --steps --strategy --cap --degree --antialias --sort --reduce --test-every --report"
    " --masks --split --checkpoint-every --preview --seed --fast --exposure --refine-poses",
    "capture": "--help --arch --out --marks --masks --no-objects --scale-points --steps --reduce --cap --cell --seed",
    "inpaint": "--help --remove --objects --out --capture --lama --keep-shadow --steps --report --truth --reduce"
    " --arch",
    "segment": "--help --splats --marks --out --model --reduce --overlay --compare",
    "bench": "--help --arch --json",
    "figures": "--help --arch --capture --out --quick",
    "tune": "--help --arch --height --json --material --out --young",
    "materials": "--help",
    "check": "--help --arch --json --quick",
    "study": "--help --form",
}
REFUSED = [  # a command line, and what is said about the option that would be ignored
    ("--render-scale .5", "--render-scale belongs to --xr"),
    ("--xr --size 320x180", "--size is not for --xr"),
    ("--stereo", "--stereo belongs to --headless"),
    ("--host ::1", "--host belongs to --web"),
    ("--sound on --headless", "--sound on: nothing is heard here"),
    ("--sound on --web", "--sound on: nothing is heard here"),
    *(
        (f"export --out a.ply {o}", "is for a splat")
        for o in ("--up +y", "--front 9", "--scale 1", "--vertices 9", "--pieces")
    ),
    ("export --out a.ply --cells uniform", "is for a splat"),
    ("export --out a.ply --format spz", "--format is for a folder"),
    ("export --out a.ply --replay a.h5 --state b.h5", "--state is not for a replay"),
    ("--replay a.h5 --state b.h5", "--state is not for a replay"),
    ("export --out a.ply --every 3", "--every is for a sequence"),
    ("export --out a.vtu --no-shadows", "--no-shadows is for splats"),
    ("prepare a.ply --cache --quantised", "--quantised belongs to --out"),
    *(
        (f"capture a --out r --no-objects {o}", "not for --no-objects")
        for o in ("--lama n", "--vertices 9", "--material wood")
    ),
    ("--participant Ida", "--participant belongs to --study"),
    ("--body a.h5 --up=-y", "--up is for a splat file"),
    ("--body ring_red --front 0", "--front is for a splat file"),
    ("prepare a --out b.h5 --static --front 90", "--front belongs to bodies"),
    ("--body ring_red --scale 1", "--scale is for a splat file"),
    ("--stage a.ply --vertices 9", "--vertices is for a splat file"),
    ("--cells uniform", "--cells is for a splat file"),
    ("--pieces", "--pieces is for a splat file"),
    ("view a.ply --snapshot a.png --frames 3", "--frames belongs to a window"),
    ("view a.ply --snapshot a.png --out b.ply", "--out is what a crop in the window is written to"),
    *((f"render a --camera b --out c.png {o}", "belongs to --turntable") for o in ("--up +y", "--elevation 3")),
    *((f"render a --camera b --out c.png {o}", "belongs to --turntable") for o in ("--size 32x32", "--frames 3")),
    *((f"prepare a --out b.h5 {o}", "belongs to --static") for o in ("--cell 1", "--cut 3")),
    ("prepare a --out b.h5 --static --pieces", "--pieces belongs to bodies"),
    *(
        (f"prepare a --out b.h5 --static {o}", "with --static nothing is simulated")
        for o in ("--vertices 9", "--cells uniform", "--material wood", "--mesher tetgen", "--no-report", "--rig r.glb")
    ),
    *((f"prepare a --cache {o}", "belongs to --out") for o in ("--force", "--quantised", "--static --up +y")),
    ("prepare a --cache --static --scale 1", "--scale belongs to --out"),
    ("prepare a --out b.h5 --static --landmarks l.json", "with --static nothing is simulated"),
    *((f"bench frame {o}", "belongs to bench") for o in ("--detail paper", "--sizes 3", "--asset a", "--acts drop")),
    *(
        (f"bench frame {o}", "belongs to bench")
        for o in ("--materials wood", "--bodies d", "--frames 3", "--quick", "--gaussians 1.313M", "--size 32x32")
    ),
    *((f"bench demos {o}", "belongs to bench") for o in ("--rounds 3", "--gaussians 1.313M")),
    *(
        (f"bench render {o}", "belongs to bench train")
        for o in ("--steps 9", "--at 9", "--reduce 2", "--test-every 4", "--cap 9", "--seed 1")
    ),
    ("bench render --variants fast", "belongs to bench train"),
    ("train c --out o.ply --checkpoint-every 0 --fresh", "--fresh belongs to --checkpoint-every"),
    ("segment c --marks m.json --out m --arch cpu", "--arch belongs to --splats"),
    ("segment a.ply --marks m.json --out m --reduce 2", "--reduce is for a capture"),
    *((f"tune a --young 1e4 {o}", "that --young does not list") for o in ("--from 1e3", "--to 1e5", "--steps 3")),
    ("study s.h5 --form --out p.csv", "--out is for the comparison"),
    ("study s.h5 --form --answers a.json", "--answers and --form do not go together"),
    ("study s.h5 --participant Ida", "--participant belongs to --form"),
    ("study s.h5 --form f.html --setting physics", "--setting belongs to --form"),
]


def refusal(words: str) -> str:
    """The message about a command line."""
    with pytest.raises(BadInput) as error:
        parse(words.split())[1]
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("words, said", REFUSED, ids=[words for words, _ in REFUSED])
def test_an_option_that_would_be_ignored_is_refused(words, said):
    assert said in refusal(words)


@pytest.mark.parametrize("name", [None, *COMMANDS], ids=str)
def test_each_option_acts_or_is_refused_somewhere(name):
    """Whoever adds an option says here whether it always acts."""
    parser = playing_parser() if name is None else command_parser(name)
    groups = [g for g in parser._action_groups if g.title == "options of scenes"]
    of_scenes = {flag for group in groups for action in group._group_actions for flag in action.option_strings}
    there = {flag for flag in parser._option_string_actions if flag.startswith("--")} - of_scenes
    lines = [words for words, _ in REFUSED if (words.split()[0] if not words.startswith("-") else None) == name]
    refused = {word.partition("=")[0] for words in lines for word in words.split() if word.startswith("--")}
    assert there == set(ALWAYS[name].split()) | (refused & there)


@pytest.mark.parametrize(
    "words, said",
    [
        ("--detial paper", "there is no option --detial; --detail?"),
        ("view --snapshto x.png foo.ply", "view has no option --snapshto; --snapshot?"),
        ("--snapshto x.png view foo.ply", "view has no option --snapshto; --snapshot?"),
        ("--stereo view a.ply", "view has no option --stereo"),
        ("veiw a", "there is no command veiw; view?"),
        ("cat.ply", "vrgs.py --scene sandbox --body cat.ply"),
        ("view", "required: FILE; see vrgs.py view --help"),
        ("scenes b", "b: is one too many"),
        ("--size 3", "--size: '3' is not WIDTHxHEIGHT"),
        ("--snapshot a.gif", "'a.gif' does not end in .png"),
        ("--frames", "--frames: expected one argument"),
        ("--re x", "ambiguous option: --re"),
    ],
)
def test_a_mistake_is_told_in_one_line_with_what_is_nearest(words, said):
    assert said in refusal(words)


@pytest.mark.parametrize(
    "words", ["--size 320x180 view a.ply", "--si=320x180 --arch cpu view a.ply", "view a.ply --si 320x180"]
)
def test_options_before_a_command_are_the_command_s(words):
    args = parse(words.split())[1]
    assert args.size == (320, 180) and args.files[0].name == "a.ply" and "--size" in args.given


@pytest.mark.parametrize("words", ["a b --cap 3", "--cap 3 a b", "a --cap 3 b"])
def test_names_may_follow_options(words):
    args = parse(["bench", "train", *words.split()])[1]
    assert (args.names, args.cap) == (["a", "b"], 3)


def test_a_value_may_be_named_as_a_command():
    """The scene "check" and the participant "view" are no commands."""
    args = parse(["--scene", "check", "--study", "s.h5", "--participant", "view"])[1]
    assert (args.scene, args.participant) == ("check", "view")


def test_the_last_of_two_options_counts_also_before_a_command():
    assert parse(["--sort", "z", "view", "a.ply", "--sort", "radial"])[1].sort == "radial"


def test_the_program_ends_with_status_2(capsys):
    assert vrgs.main(["--stereo"]) == 2
    assert capsys.readouterr().err == "vrgs: --stereo belongs to --headless\n"


def test_orders_of_blending_are_those_of_the_renderer():
    """Written out, so that a command line is read without NumPy."""
    assert get_args(Sort) == SORTS


def test_no_word_at_all_plays_the_ring_toss():
    assert parse([])[1].scene == "ring_toss" and scene_file_in(["--scene"]) is None


def test_an_interrupt_that_comes_while_an_object_is_freed_ends_the_program(monkeypatch, capsys):
    class Freed:
        def __del__(self):
            raise KeyboardInterrupt

    def run(argv):
        freed = Freed()
        del freed  # ignored here
        time.sleep(10)

    monkeypatch.setattr(vrgs, "run", run)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert vrgs.main([]) == 130
    finally:
        signal.signal(signal.SIGINT, handler)
    assert capsys.readouterr().err == "vrgs: interrupted\n"
