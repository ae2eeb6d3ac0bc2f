"""The command line: each option acts or is refused in one line, before anything is read or started."""

import signal
import time
from typing import get_args

import pytest

import vrgs
from commands.options import Sort
from commands.parser import COMMANDS, command, command_parser, parse, playing_parser, scene_file_in
from commands.play_options import PlayOptions
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
    "prepare": "--help --arch --out --cache --static",
    "convert": "--help --decimate",
    "train": "--help --arch --out --steps --strategy --cap --degree --antialias --sort --reduce --test-every --report"
    " --masks --checkpoint-every --preview --seed --fast --exposure --refine-poses",
    "capture": "--help --arch --out --marks --masks --no-objects --scale-points --steps --reduce --cap --cell --seed",
    "inpaint": "--help --remove --objects --out --capture --lama --keep-shadow --steps --report --arch",
    "segment": "--help --marks --out",
    "bench": "--help --arch --json",
    "figures": "--help --arch --capture --out --quick",
    "fit": "--help --from-trajectory --camera --capture --marks --part --fps --plane --release --out --report --preview"
    " --density --arch",
    "tune": "--help --arch --height --json --material --out --young",
    "materials": "--help",
    "check": "--help --arch --json --quick",
    "study": "--help --form",
}
REFUSED = [  # for each condition a command line, and what is said about the option that would be ignored
    ("--render-scale .5", "--render-scale belongs to --xr"),
    ("--xr --size 320x180", "--size is not for --xr"),
    ("--stereo", "--stereo belongs to --headless"),
    ("--host ::1", "--host belongs to --web"),
    ("--sound on --headless", "--sound on: there is no sound here"),
    ("--sound on --web", "--sound on: there is no sound here"),
    ("--participant Ida", "--participant belongs to --study"),
    ("--replay a.h5 --state b.h5", "--state is not for a replay"),
    ("--body a.h5 --up=-y", "--up is for a splat file"),
    ("--stage a.ply --vertices 9", "--vertices is for a splat file"),
    ("--pieces", "--pieces is for a splat file"),
    ("export --out a.ply --cells uniform", "--cells is for a splat file"),
    ("export --out a.ply --replay a.h5 --state b.h5", "--state is not for a replay"),
    ("export --out a.ply --format spz", "--format is for a folder"),
    ("export --out a.ply --every 3", "--every is for a sequence"),
    ("export --out a.vtu --no-shadows", "--no-shadows is for splats"),
    ("export --out a.html --embedding one-level", "--embedding is not for a .html"),
    ("capture a --out r --no-objects --lama n", "--lama is not for --no-objects"),
    ("view a.ply --snapshot a.png --frames 3", "--frames belongs to a window"),
    ("view a.ply --snapshot a.png --out b.ply", "--out is where a crop made in the window is written"),
    ("convert a.ply b.ply --spz-version 4", "--spz-version belongs to a .spz"),
    ("convert a.ply b.spz --up +y", "--up belongs to a .glb"),
    ("render a --camera b --out c.png --up +y", "--up belongs to --turntable"),
    ("prepare a --out b.h5 --cell 1", "--cell belongs to --static"),
    ("prepare a --out b.h5 --static --pieces", "--pieces belongs to bodies"),
    ("prepare a --out b.h5 --static --front 90", "with --static nothing is simulated"),
    ("prepare a --cage c.usd --out b.h5 --vertices 99", "--vertices is not for --cage"),
    ("prepare a --cache --force", "--force belongs to --out"),
    ("prepare a --cache --static --scale 1", "--scale belongs to --out"),
    ("bench frame --test-every 4", "--test-every belongs to bench train"),
    ("bench demos --rounds 3", "--rounds belongs to bench sim and render"),
    ("train c --out o.ply --checkpoint-every 0 --fresh", "--fresh belongs to --checkpoint-every"),
    ("train c --out o.ply --masks none --split", "--split belongs to --masks"),
    ("inpaint a --remove b --out c.ply --truth t", "--truth belongs to --capture and --report"),
    ("inpaint a --remove b --out c.ply --capture c --reduce 2", "--reduce belongs to --truth"),
    ("segment c --marks m.json --out m --arch cpu", "--arch belongs to --splats"),
    ("segment a.ply --marks m.json --out m --reduce 2", "--reduce is for a capture"),
    ("fit a.h5 b.mp4 --out c.h5 --camera d.json --fov 40", "--fov belongs to --capture"),
    ("tune a --young 1e4 --from 1e3", "--from is for moduli that --young does not list"),
    ("study s.h5 --form --out p.csv", "--out is for the comparison"),
    ("study s.h5 --form --answers a.json", "--answers and --form do not go together"),
    ("study s.h5 --participant Ida", "--participant belongs to --form"),
    ("study s.h5 --form f.html --setting physics", "--setting belongs to --form"),
]


def refusal(words: str) -> str:
    """The message about a command line."""
    with pytest.raises(BadInput) as error:
        parse(words.split())
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("words, said", REFUSED, ids=[words for words, _ in REFUSED])
def test_an_option_that_would_be_ignored_is_refused(words, said):
    assert said in refusal(words)


@pytest.mark.parametrize("name", [None, *COMMANDS], ids=str)
def test_each_option_acts_or_has_a_condition(name):
    """Whoever adds an option says here that it always acts, or in the command under which condition."""
    parser, kind = (playing_parser([]), PlayOptions) if name is None else (command_parser(name, []), command(name)[1])
    there = {flag for flag in parser._option_string_actions if flag.startswith("--")}
    conditional = {flag for condition in kind.CONDITIONS for flag in condition.flags}
    assert there == set(ALWAYS[name].split()) | conditional


@pytest.mark.parametrize(
    "words, said",
    [
        ("--detial paper", "unknown option --detial; did you mean --detail?"),
        ("view --snapshto x.png foo.ply", "view has no option --snapshto; did you mean --snapshot?"),
        ("--snapshto x.png view foo.ply", "view has no option --snapshto; did you mean --snapshot?"),
        ("--stereo view a.ply", "view has no option --stereo"),
        ("veiw a", "unknown command veiw; did you mean view?"),
        ("sandbox", "sandbox is a scene, no command: vrgs.py --scene sandbox"),
        ("--body a.ply --scale 1e9", "'1e9' is too large: below 1e9"),
        ("--body a.ply --scale nan", "'nan' is not a positive number"),
        ("prepare a.ply --out a.h5 --vertices 1e9", "'1e9' is not a positive whole number"),
        ("cat.ply", "vrgs.py --scene sandbox --body cat.ply"),
        ("view", "required: FILE; see vrgs.py view --help"),
        ("scenes b", "unexpected argument b"),
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


def test_the_help_begins_with_commands_and_examples():
    said = playing_parser().format_help()
    parts = ["usage: ", "commands (", "examples:", "--scene sandbox --stage", "options:", "--detail"]
    assert (places := [said.index(part) for part in parts]) == sorted(places)
    assert all(f"\n  {name} " in said[: places[2]] for name in COMMANDS)


def test_no_word_at_all_plays_the_ring_toss():
    assert parse([])[1].scene == "ring_toss" and scene_file_in(["--scene"]) is None


def test_an_interrupt_that_comes_while_an_object_is_freed_ends_the_program(monkeypatch, capsys):
    class Freed:
        def __del__(self):
            raise KeyboardInterrupt

    def run(argv):
        freed = Freed()
        del freed  # ignored here
        for _ in range(100):  # an interrupt that Python sends itself waits for the end of a sleep
            time.sleep(0.1)

    monkeypatch.setattr(vrgs, "run", run)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert vrgs.main([]) == 130
    finally:
        signal.signal(signal.SIGINT, handler)
    assert capsys.readouterr().err == "vrgs: interrupted\n"


@pytest.mark.parametrize(
    "error, line",
    [
        (
            "CUDA Error CUDA_ERROR_ILLEGAL_ADDRESS: while calling",
            "fails on this GPU (CUDA_ERROR_ILLEGAL_ADDRESS): --arch",
        ),
        ("CUDA Error CUDA_ERROR_OUT_OF_MEMORY: out of memory", "not enough memory"),
    ],
)
def test_what_the_machine_cannot_do_is_said_in_one_line(monkeypatch, capsys, error, line):
    def fail(options):
        raise RuntimeError(f"[cuda_driver.h:operator()@93] {error}")

    monkeypatch.setattr(vrgs, "play", fail)
    assert vrgs.main([]) == 2
    said = capsys.readouterr().err
    assert line in said and said.count("\n") == 1


@pytest.mark.parametrize("backend", ["taichi", "quadrants"])
def test_a_back_end_that_is_missing_is_told_in_a_line(monkeypatch, capsys, backend):
    monkeypatch.setenv("VRGS_BACKEND", backend)
    monkeypatch.setattr("core.program.find_spec", lambda name: None)
    assert vrgs.main(["scenes"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"vrgs: VRGS_BACKEND={backend} needs that package: ") and said.count("\n") == 1


def test_an_unknown_back_end_is_refused(monkeypatch, capsys):
    monkeypatch.setenv("VRGS_BACKEND", "numpy")
    assert vrgs.main(["scenes"]) == 2
    assert capsys.readouterr().err == "vrgs: VRGS_BACKEND=numpy: it is taichi or quadrants\n"
