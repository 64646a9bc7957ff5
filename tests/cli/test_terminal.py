"""What a person meets at the terminal: messages in whole lines, bars above which they go, closing lines."""

import io
import re
import subprocess
import sys
from contextlib import redirect_stderr

import pytest

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.cli.main import VERBS, main
from turtlebag.pipeline.navigation.driver_setup import DEFAULT_DURATION_S, DEFAULT_EXPLORE_S, SINGLE_GOAL
from turtlebag.pipeline.stages.map_summary import map_lines, tell_map
from turtlebag.pipeline.terminal import messages as console
from turtlebag.planners.tasks.patrol import SequenceConfig


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def normal():
    console.set_verbosity(0)
    yield
    console.set_verbosity(0)


def test_the_help_of_navigate_tells_the_times_that_are_taken(capsys):
    with pytest.raises(SystemExit):
        main(["navigate", "--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert f"(default: {SequenceConfig().timeout:g} in a patrol, {SINGLE_GOAL['timeout']:g} for" in told
    assert f"avoid (default: {DEFAULT_DURATION_S:g})" in told
    assert f"explore (default: {DEFAULT_EXPLORE_S:g})" in told


def test_the_version_is_told(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == "turtlebag 0.2.0\n"


ACTIONS = [
    *(f"bag {action}" for action in ("info", "doctor", "play", "recover", "convert")),
    *("world list", "world show", "data list", "data fetch"),
]


@pytest.mark.parametrize("verb", [*VERBS, *ACTIONS])
def test_the_help_of_a_verb_has_an_example(capsys, verb):
    with pytest.raises(SystemExit) as ended:
        main([*verb.split(), "--help"])
    assert ended.value.code == 0
    assert "example:\n  turtlebag " + verb in capsys.readouterr().out


def test_a_terminal_of_few_letters_gets_plain_ones(monkeypatch):
    shown = io.TextIOWrapper(io.BytesIO(), encoding="ascii", newline="\n")
    monkeypatch.setattr(sys, "stdout", shown)
    with console.guarded_streams():
        print("\u22120.35\u202fcm, 0.15\u202f\u00b0, caf\u00e9")
    assert shown.buffer.getvalue() == b"-0.35 cm, 0.15 deg, caf?\n"


def test_a_message_during_a_bar_has_its_own_line_above_it(normal):
    with redirect_stderr(Terminal()) as terminal, console.simulated_time(10.0) as clock:
        clock(4 * 10**9, "follow")
        console.log.info("goal 1 of 2: reached")
    written = terminal.getvalue()
    assert written.count("goal 1 of 2: reached\n") == 1
    assert "4 s of 10 s simulated" in written
    assert "follow" in written


def test_a_command_that_loads_says_so_on_a_terminal_and_nowhere_else(normal):
    with redirect_stderr(Terminal()) as terminal:
        console.starting()
    assert terminal.getvalue() == "starting ...\r"  # the next line is written over it
    with redirect_stderr(io.StringIO()) as file:
        console.starting()
    assert not file.getvalue()


def test_frames_are_redrawn_in_place_with_messages_above(normal):
    with redirect_stderr(Terminal()) as terminal, console.redrawn() as redraw:
        redraw("1.0 s")
        console.log.info("goal 1 of 2: reached")
        redraw("2.0 s")
    written = terminal.getvalue()
    assert written.index("1.0 s") < written.index("goal 1 of 2: reached\n") < written.index("2.0 s")


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_without_a_terminal_or_quietly_no_bar_is_drawn(normal, stream):
    console.set_verbosity(-1 if stream is Terminal else 0)
    with redirect_stderr(stream()) as written:
        with console.simulated_time() as clock, console.drawing() as told, console.redrawn() as redraw:
            clock(10**9, "follow")
            told("a figure")
            redraw("a frame")
        assert list(console.track(range(3), "some")) == [0, 1, 2]
    assert written.getvalue() == ""


def test_results_go_to_stdout_though_a_bar_is_shown(normal, capsys):
    with redirect_stderr(Terminal()) as terminal, console.simulated_time() as clock:
        clock(10**9, "")
        console.say("a decision")
    assert capsys.readouterr().out == "a decision\n"
    assert "a decision" not in terminal.getvalue()


def test_a_map_ends_with_its_verdict_its_errors_and_its_files(tmp_path):
    for name in ("map.pgm", "map.yaml", "map_house.pgm", "map_house.yaml", "config.yaml", "metrics.json"):
        (tmp_path / name).touch()
    metrics = {
        "scans": 1123,
        "keyframes": 143,
        "loops": {"proposed": 34, "accepted": 33, "rejected": 1},
        "self_check": {"verdict": "good", "reasons": [], "revisits": 58},
    }
    errors = {
        "ate_m": {"rmse": 0.0022, "max": 0.007},
        "map": {"occupied_error_m": {"mean": 0.0076, "p95": 0.05, "within_one_cell": 1.0}},
    }
    files = f"{tmp_path}: map.pgm, map.yaml, map_house.pgm, map_house.yaml"
    first = "good map of 1123 scans (143 key scans, 33 of 34 loop candidates accepted) in 91.0 s"
    assert list(map_lines(metrics, tmp_path, 91.0)) == [first, files]
    little = {"scans": 9, "keyframes": 1, "self_check": {"verdict": "good", "reasons": [], "revisits": 0}}
    assert list(map_lines({**metrics, **little}, tmp_path, 1.0))[:2] == [
        "good map of 9 scans (1 key scan, 33 of 34 loop candidates accepted) in 1.0 s",
        "no place was seen twice, so the self-check had nothing to compare",
    ]
    assert list(map_lines({**metrics, **errors}, tmp_path, 91.0)) == [
        first,
        "trajectory error (ATE): 0.22 cm RMSE, 0.70 cm at most",
        "wall error: 0.76 cm on average, 100.0% of the cells within one cell",
        files,
    ]
    own = {"fitted": "it has a frame of its own", "ate_aligned_m": {"rmse": 0.001, "max": 0.002}}
    (line,) = (one for one in map_lines({**metrics, **errors, **own}, tmp_path, 91.0) if "ATE" in one)
    assert line.endswith("0.10 cm RMSE, 0.20 cm at most after a rigid fit: it has a frame of its own")


@pytest.mark.parametrize(
    ("reasons", "worst", "within", "first", "said"),
    [
        ([], None, None, "good", ""),
        (["it is bent"], None, None, "doubtful", "doubtful map: it is bent"),
        ([], 0.15, None, "good", ""),
        ([], 0.15, 0.95, "good", ""),
        (
            [],
            0.15,
            0.54,
            "bad",
            "bad map: only 54.0% of its wall cells lie within one cell of a true surface",
        ),
        (["it is bent"], 0.15, None, "doubtful", "doubtful map: it is bent"),
        (["it is bent"], 0.25, 1.0, "bad", "bad map: a scan of it lies 25.0 cm off"),
        ([], 0.25, None, "bad", "does the ground truth belong to this recording?"),
    ],
)
def test_a_map_that_the_truth_denies_is_bad_whatever_the_mapper_believes(
    normal, tmp_path, capfd, reasons, worst, within, first, said
):
    console.set_verbosity(0)
    check = {"verdict": "doubtful" if reasons else "good", "reasons": reasons, "revisits": 1}
    loops = {"proposed": 0, "accepted": 0, "rejected": 0}
    metrics = {"scans": 9, "keyframes": 3, "loops": loops, "self_check": check}
    if worst is not None:
        # Not aligned it is off by more: a map without odometry begins at the origin.
        metrics |= {"ate_m": {"rmse": 2.0, "max": 2.1}, "ate_aligned_m": {"rmse": 0.1, "max": worst}}
    if within is not None:
        metrics["map"] = {"occupied_error_m": {"mean": 0.05, "p95": 0.1, "within_one_cell": within}}
    assert tell_map(metrics, tmp_path, 1.0) == (first != "bad")
    told = capfd.readouterr().err
    assert f"{first} map of 9 scans" in told
    assert said in told
    assert ("is the truth" in told) == ("is the truth" in said)


HEAVY = {"numba", "scipy", "gtsam", "pybullet", "ompl", "open3d", "matplotlib", "rosbags", "PIL", "duckdb"}


SLOW = {"rich", "turtlebag.datasets.outputs", "importlib.metadata"}
"""What is not as heavy, but as much as all that a look at a bag needs."""


def loaded_after(code):
    """The heavy packages and slow modules that are imported when some code has run."""
    code += "\nimport sys\nprint('LOADED', *sys.modules, *{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    return set(done.stdout.rpartition("LOADED")[2].split()) & (HEAVY | SLOW)


@pytest.mark.slow
def test_the_help_of_every_verb_loads_nothing_heavy():
    words = "from turtlebag.pipeline.cli.main import VERBS, build_parser\n"
    assert not loaded_after(words + "for verb in VERBS: build_parser(verb)") & HEAVY


def test_looking_at_a_bag_loads_what_reads_it_and_no_more(tmp_path):
    with BagWriter(tmp_path / "bag", custom={"seed": "1"}) as bag:
        bag.command(10**9, Twist(0.1, 0.0))
    look = f"assert main(['bag', 'info', {str(tmp_path / 'bag')!r}]) == 0"
    assert loaded_after("from turtlebag.pipeline.cli.main import main\n" + look) == set()


@pytest.mark.slow
def test_a_drive_loads_no_pose_graph_and_no_plots():
    modules = "import turtlebag.pipeline.stages.navigate, turtlebag.pipeline.navigation.driver_setup"
    assert not loaded_after(modules) & {"gtsam", "open3d", "matplotlib", "duckdb"}


HOSTILE = "/scan\x1b]0;owned\x07\x1b[2J\r\nturtlebag: all is well\x9b31m\u202egnp"
SHOWN = r"/scan\x1b]0;owned\x07\x1b[2J\r\nturtlebag: all is well\x9b31m\u202egnp"


def obeyed(text):
    """Control characters that a terminal would act upon, apart from the end of a line."""
    return re.findall("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", text)


def test_what_others_wrote_is_shown_in_one_line_and_not_obeyed(normal, capsys):
    with console.guarded_streams():
        console.log.warning("note: %s", HOSTILE)
        console.say(HOSTILE)
        console.print_table([("topic", "n"), (HOSTILE, "1")])
        print(HOSTILE.partition("\r")[0])
        print(HOSTILE.partition("\r")[0], file=sys.stderr)
    out, err = capsys.readouterr()
    assert out.splitlines()[0] == SHOWN
    assert out.splitlines()[2].split("  ") == [SHOWN, "1"]
    assert err.splitlines()[0] == f"note: {SHOWN}"
    assert out.splitlines()[3] == err.splitlines()[1] == r"/scan\x1b]0;owned\x07\x1b[2J"
    assert not obeyed(out + err)
    assert (out + err).count("\n") == 6


def test_bars_and_redrawn_frames_show_it_too_and_their_own_commands_still_work(normal):
    with redirect_stderr(Terminal()) as terminal, console.guarded_streams():
        with console.simulated_time(10.0) as clock:
            clock(10**9, HOSTILE + "[/red]")
            console.log.info(HOSTILE)
        with console.redrawn() as redraw:
            redraw(HOSTILE)
    written = terminal.getvalue()
    assert SHOWN in written
    assert "\x1b[?25l" in written  # rich's own: the cursor is hidden
    assert not re.search("\x1b]0|\x1b\\[2J|\x9b|\u202e|\x07", written)


@pytest.mark.parametrize(
    "words", [("map", "{}"), ("map", "a", "--name", "{}"), ("bag", "info", "{}"), ("{}",), ("map", "--{}")]
)
def test_an_error_that_names_it_is_one_line(capsys, words):
    assert main([word.format(HOSTILE) for word in words]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert not obeyed(err)


def test_topics_and_frames_of_a_bag_are_shown_and_not_obeyed(tmp_path, capsys):
    name = "/a" + HOSTILE
    with BagWriter(tmp_path / "bag", custom={"seed" + HOSTILE: HOSTILE}) as bag:
        bag.static_transforms(0, [(HOSTILE, "base_scan", (0.0, 0.0, 0.0), 0.0)])
        channel = bag.add_topic(name, "std_msgs/msg/Bool", "bool data")
        bag.write(channel, 0, b"\0\1\0\0\1")
    path = str(tmp_path / "bag")
    assert main(["bag", "info", path]) == 0
    assert SHOWN in capsys.readouterr().out
    assert main(["bag", "doctor", path]) == 1
    assert main(["map", path, "--out", str(tmp_path / "out")]) == 2
    assert main(["bag", "convert", path, "--exclude", HOSTILE, "--out", str(tmp_path / "out")]) == 2
    said = "".join(capsys.readouterr())
    assert SHOWN in said
    assert not obeyed(said)


def test_a_traceback_is_shown_and_not_obeyed():
    code = (
        "import sys; from turtlebag.pipeline import __main__ as door\n"
        "from turtlebag.pipeline.cli import doctor\n"
        f"def run(args): raise RuntimeError({HOSTILE!r})\n"
        "doctor.run = run; sys.argv[1:] = ['doctor']; sys.exit(door.run())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True)
    said = done.stderr.decode()
    assert done.returncode == 1
    assert said.startswith("Traceback")
    assert r"RuntimeError: /scan\x1b]0;owned\x07\x1b[2J\r" in said
    assert not obeyed(said)
