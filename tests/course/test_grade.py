"""The course: right solutions pass, wrong ones are told what is wrong, and no file stops the grading."""

import json

import pytest

from turtlebag.datasets.outputs import sha256_tree
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.course.grade import LESSONS, grade, marked, solution_of
from turtlebag.pipeline.course.lesson import mark_of, pose_words

pytestmark = pytest.mark.slow

SOLVED = "from turtlebag.pipeline.course.solutions.lesson{} import {} as Solved\n\n\n"
MATCHER = SOLVED.format(2, "ScanMatcher") + "class ScanMatcher(Solved):\n"
FILTER = SOLVED.format(6, "ParticleFilter") + "class ParticleFilter(Solved):\n"
INVERSE = "return super().match(points_b, points_a, -guess)"
DEGREES = "return super().match(points_a, points_b, guess) * [1, 1, 57.29578]"
SAME_WEIGHTS = "self.distance = self.distance * 0; return super().update(motion, points)"
BARE = "class ParticleFilter:\n    def __init__(self): pass\n    def update(self): pass"
MATCH = "    def match(self, points_a, points_b, guess):\n        "
UPDATE = "    def update(self, motion, points):\n        "
WRONG = {
    "inverse": (2, f"{MATCHER}{MATCH}{INVERSE}", "this is the inverse"),
    "guess": (2, f"{MATCHER}{MATCH}return guess", "this is the guess, unchanged"),
    "degrees": (2, f"{MATCHER}{MATCH}{DEGREES}", "the yaw is in degrees"),
    "shape": (2, f"{MATCHER}{MATCH}return guess[:2]", "an array of shape (2,); it must be (3,)"),
    "nan": (2, f"{MATCHER}{MATCH}return guess / 0.0", "match returned numbers that are not finite"),
    "nothing": (2, f"{MATCHER}{MATCH}pass", "TypeError: match returned nothing"),
    "still": (6, f"{FILTER}{UPDATE}return self.poses[0] * 0 + 1", "the particles are not moved by `motion`"),
    "same weights": (6, f"{FILTER}{UPDATE}{SAME_WEIGHTS}", "this follows the wheels alone"),
    "index": (6, f"{FILTER}{UPDATE}return self.poses[999999]", "IndexError: index 999999 is out of bounds"),
    "init": (6, BARE, "TypeError"),
}
"""Lesson, file, and part of what is said of it."""
UNUSABLE = {
    "empty": ("", "the file has no class ScanMatcher"),
    "method": ("class ScanMatcher: pass", "the class ScanMatcher has no method match"),
    "import": ("import nothere", "ModuleNotFoundError: No module named 'nothere' (line 1)"),
    "syntax": ("x = 1\nclass :", "SyntaxError: invalid syntax (line 2)"),
    "exit": ("import os\nos._exit(0)", "it ended before it answered (exit code 0)"),
    "endless": (f"class ScanMatcher:\n{MATCH}\n        while True: pass", "it did not end"),
    "prints": ("for i in range(1_000_000): print(i)\n" + MATCHER + "    pass", "it printed more than 100 kB"),
    "memory": ("x = bytearray(10**11)", "MemoryError"),
    "bytes": ("\x00\x01", "SyntaxError"),
}


@pytest.fixture
def file(tmp_path):
    return tmp_path / "hw.py"


@pytest.mark.parametrize("number", LESSONS)
@pytest.mark.parametrize("salt", ["", "spring", "0"])
def test_the_solution_has_full_marks_with_any_salt(number, salt):
    lesson = LESSONS[number]
    cases = [("hidden", case) for case in lesson.hidden(salt)]
    graded = marked(solution_of(number), lesson, cases, 60)
    assert graded.mark == 100, graded.words
    assert graded.cpu_s < 10.0


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_solution_is_told_what_is_wrong(name, file):
    number, text, words = WRONG[name]
    file.write_text(text)
    graded = grade(file, number)
    assert not graded.passed
    assert words in graded.words
    assert "\n" not in graded.words


@pytest.mark.parametrize("name", UNUSABLE)
def test_a_file_that_cannot_be_asked_has_mark_0_a_page_and_one_line(name, file, tmp_path, capsys):
    text, words = UNUSABLE[name]
    file.write_text(text)
    assert main(["grade", str(file), "--lesson", "2", "--out", str(tmp_path / "out"), "-q"]) == 1
    said = capsys.readouterr().out
    assert said.startswith(f"lesson 2: 0 of 100, not passed; {words}")
    assert said.count("\n") == 1
    assert "0 of 100" in (tmp_path / "out/index.html").read_text()
    assert json.loads((tmp_path / "out/metrics.json").read_text())["mark"] == 0


def test_the_same_file_and_salt_give_the_same_bytes_also_with_two_threads(file, tmp_path, monkeypatch):
    # Right for scans that turn left, and it says where an object is, which differs from run to run.
    file.write_text(
        f"{MATCHER}{MATCH}print('hello')\n        if guess[2] < 0: raise ValueError(object())\n"
        "        return super().match(points_a, points_b, guess)"
    )
    for threads in "12":
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        words = ["grade", str(file), "--lesson", "2", "--salt", "s", "--out", str(tmp_path / threads), "-q"]
        main(words)
    assert sha256_tree(tmp_path / "1") == sha256_tree(tmp_path / "2")
    mark = json.loads((tmp_path / "1/metrics.json").read_text())["mark"]
    assert 0 < mark < 100
    assert mark % 10 == 0
    assert "hello" in (tmp_path / "1/index.html").read_text()


def test_another_salt_has_other_hidden_cases_and_the_same_visible_ones():
    lesson = LESSONS[2]
    a, b = ([case.truth.tolist() for case in lesson.hidden(salt)] for salt in ("a", "b"))
    assert not any(truth in b for truth in a)
    assert [case.truth.tolist() for case in lesson.visible()] == [c.truth.tolist() for c in lesson.visible()]


def test_the_process_of_the_file_has_neither_salt_nor_solutions(file):
    file.write_text(
        "import os, sys\nclass ScanMatcher:\n"
        f"{MATCH}names = [n for n in sys.modules if n.startswith('turtlebag.')]\n"
        "        print(*sorted(names), *sys.argv, *os.environ.values())\n        return guess"
    )
    printed = grade(file, 2, "very-secret").printed
    assert "turtlebag.datasets" not in printed
    assert "ScanMatcher" in printed
    for absent in ("very-secret", "course.solutions", "course.lesson", "scan_matching"):
        assert absent not in printed


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["nowhere.py", "--lesson", "2"], "nowhere.py: no such file"),
        (["hw.py", "--lesson", "99"], "--lesson 99: no such lesson (there are "),
        (["hw.py", "--lesson", "two"], "--lesson: "),
    ],
)
def test_only_a_file_or_lesson_that_does_not_exist_is_exit_2(
    words, line, file, tmp_path, monkeypatch, capsys
):
    file.write_text(f"{MATCHER}    pass")
    monkeypatch.chdir(tmp_path)
    assert main(["grade", *words, "--out", "out"]) == 2
    assert line in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_marks_come_in_steps_of_ten():
    assert mark_of([2] * 8) == 100
    assert mark_of([2] * 7 + [1]) == 90
    assert mark_of([1] * 8) == 50
    assert mark_of([0] * 8) == 0


def test_usual_mistakes_of_a_pose_have_names():
    T = SE2.from_xyt(0.5, 0.1, 0.6)
    assert "inverse" in pose_words(T.inverse().xyt, T.xyt, 0.1)
    assert "wrong sign" in pose_words(T.xyt * [1, 1, -1], T.xyt, 0.1)
    assert "exchanged" in pose_words(T.xyt[[1, 0, 2]], T.xyt, 0.1)
    assert "position is right, the yaw is off by 0.60 rad" in pose_words(T.xyt * [1, 1, 0], T.xyt, 0.1)
