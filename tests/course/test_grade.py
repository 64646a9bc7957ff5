"""The course: right solutions pass, wrong ones are told what is wrong, and no file stops the grading."""

import dataclasses
import json
import runpy
import subprocess
import sys
import threading
import time
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from turtlebag import testing
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.course.grade import (
    LESSONS,
    Outcome,
    grade,
    lesson_of,
    marked,
    solution_of,
    solved_cases,
)
from turtlebag.pipeline.course.lesson import FULL, HIDDEN, mark_of, pose_words
from turtlebag.pipeline.course.page import grade_page
from turtlebag.pipeline.course.process import Ended, Fault, Pupil

pytestmark = pytest.mark.slow

MATCH = (2, "ScanMatcher", "match(self, points_a, points_b, guess)")
ODOMETRY = (1, "WheelOdometry", "update(self, left, right)")
BACK_END = (3, "BackEnd", "optimise(self, T_map_keys, constraints, iterations)")
ADD = (3, "BackEnd", "_add(self, H, b, poses, c)")
CHECK = (4, "LoopCheck", "accept(self, T_map_keys, steps, loops)")
MAPPER = (5, "GridMapper", "map(self, poses, ranges, angles)")
FILTER = (6, "ParticleFilter", "update(self, motion, points)")
PLAN = (7, "GlobalPlanner", "plan(self, costmap, model, T_map_start, T_map_goal, seed)")
COMMAND = (7, "Controller", "command(self, pose, last, costmap)")
AVOID = (8, "Avoider", "command(self, ranges)")
FROM_ZERO = """if self.last is None: self.last = [0, 0]
        return super().update(left, right)"""
MAP = "super().map(poses, ranges, angles)"
ALWAYS_HELD = f"np.maximum(super().map(poses[:4], ranges[:4], angles).round(), {MAP})"
THROUGH_A_PILLAR = "np.vstack([np.linspace(T_map_start.xyt, 0, 60), np.linspace(0, T_map_goal.xyt, 60)])"
WRONG = [
    (ODOMETRY, "return [self.x, self.y, self.yaw]", "it stays at the start"),
    (ODOMETRY, "return super().update(right, left)", "left and right are exchanged"),
    (ODOMETRY, "return super().update(2 * left, 2 * right)", "diameter is used as its radius"),
    (ODOMETRY, FROM_ZERO, "it does not begin at the start"),
    (MATCH, "return super().match(points_b, points_a, -guess)", "this is the inverse"),
    (MATCH, "return guess", "this is the guess, unchanged"),
    (MATCH, "return super().match(points_a, points_b, guess) * [1, 1, 57.29578]", "the yaw is in degrees"),
    (MATCH, "return guess[:2]", "an array of shape (2,); it must be (3,)"),
    (MATCH, "return guess / 0.0", "match returned numbers that are not finite"),
    (MATCH, "pass", "TypeError: match returned nothing"),
    (BACK_END, "return T_map_keys", "the poses are still those of the start"),
    (BACK_END, "return T_map_keys.xyt + 0.2", "the first pose has moved"),
    (BACK_END, "return T_map_keys.xyt * np.linspace(1, 2, 60)[:, None]", "the cost has grown"),
    (BACK_END, "return super().optimise(T_map_keys, constraints, 1)", "not at the minimum"),
    (ADD, "c.information[:] = np.eye(3); super()._add(H, b, poses, c)", "the information is not used"),
    (CHECK, "return [True for loop in loops]", "all loops are accepted, also 5 of places"),
    (CHECK, "return [False for loop in loops]", "no loop is accepted: the drift stays"),
    (CHECK, "return ~super().accept(T_map_keys, steps, loops)", "5 wrong loops are accepted, as "),
    (MAPPER, f"return {MAP}[::-1]", "row 0 must have the lowest y"),
    (MAPPER, f"return 9 * {MAP} - 4", "not probabilities: -4.0 to 5.0"),
    (MAPPER, f"return {MAP}.T", "it must be ("),
    (MAPPER, f"return 1 - {MAP}", "occupied and free are exchanged"),
    (MAPPER, f"return np.maximum({MAP}, 0.5)", "100 % of the free cells are not free"),
    (MAPPER, "return np.zeros((self.rows, self.cols))", "100 % of the walls are missing"),
    (MAPPER, f"return {ALWAYS_HELD}", "where somebody stood it is still occupied"),
    (FILTER, "return self.poses[0] * 0 + 1", "the particles are not moved by `motion`"),
    (FILTER, "self.distance *= 0; return super().update(motion, points)", "this follows the wheels alone"),
    (FILTER, "return self.poses[999999]", "IndexError: index 999999 is out of bounds"),
    ((6, "ParticleFilter", "__init__(self)"), "pass", "TypeError"),
    (PLAN, f"return {THROUGH_A_PILLAR}", "the path leads through an obstacle at"),
    (PLAN, "return SE2.stack([T_map_start, T_map_start])", "in place of the goal"),
    (PLAN, "return SE2.stack([T_map_start, T_map_goal])", "poses of the path are"),
    (COMMAND, "return Twist(0.0, 0.1)", "it does not drive"),
    (COMMAND, "return Twist(0.2, 0.0)", "it touches something at"),
    (AVOID, "return [self.max_v, 0]", "it touches a wall at"),
    (AVOID, "return [0, 0]", "it does not drive"),
    (AVOID, "return [0.1, 0.8]", "it goes round and round"),
]
"""A method of the solution, what it does instead, and part of what is said of it."""
QUICK = [number for number in LESSONS if number != 7]
"""Those whose cases the solution plays in a moment: a patrol takes seconds, so that lesson's are two."""
CLASS = {number: next(iter(lesson_of(number).wanted)) for number in LESSONS}
"""Of each lesson, the first class to complete."""
NOTEBOOKS = Path(__file__).parents[2] / "docs/course"
UNUSABLE = {
    "empty": ("", "the file has no class {name}"),
    "method": ("class {name}: pass", "the class {name} has no method"),
    "import": ("import nothere", "ModuleNotFoundError: No module named 'nothere' (line 1)"),
    "solutions": ("import turtlebag.pipeline.course.solutions.lesson{number}", "ModuleNotFoundError"),
    "syntax": ("x = 1\nclass :", "SyntaxError: invalid syntax (line 2)"),
    "exit": ("import os\nos._exit(0)", "it ended before it answered (exit code 0)"),
    "endless": ("while True: pass", "it did not end"),
    "prints": ("for i in range(1_000_000): print(i)", "it printed more than 100 kB"),
    "memory": ("x = bytearray(10**11)", "MemoryError"),
    "bytes": ("\x00\x01", "SyntaxError"),
}


def changed(number, name, head, body):
    """The text of the solution, with another method."""
    solution = solution_of(number).read_text()
    return f"{solution}\n\nclass {name}({name}):\n    def {head}:\n        {body}\n"


@cache
def cases_of(number):
    """The cases of a mark, as if the solution had played them; the first is what everybody sees first."""
    lesson = lesson_of(number)
    named = [(f"visible {k}", case) for k, case in enumerate(lesson.visible(), 1)]
    named += [(f"hidden {k}", case) for k, case in enumerate(islice(lesson.hidden(""), HIDDEN), 1)]
    return [Outcome(case, name, FULL, "right") for name, case in named]


def first_case(number):
    """What everybody sees first."""
    return cases_of(number)[0]


@cache
def solution_in(number):
    """The cases of a mark, as the solution solves them, and the limit of CPU seconds."""
    return solved_cases(lesson_of(number), "")


@pytest.fixture
def file(tmp_path):
    return tmp_path / "hw.py"


@pytest.mark.parametrize("number", QUICK)
def test_the_solution_solves_all_cases(number):
    solution, limit_s = solution_in(number)
    assert [one.name for one in solution] == [one.name for one in cases_of(number)]
    assert limit_s <= 100  # ten times what it took


@pytest.mark.parametrize("number", range(1, 8))
def test_the_solution_has_full_marks(number):
    """In two cases: it solves the others, too, and would take as long again."""
    graded = marked(solution_of(number), lesson_of(number), cases_of(number)[1:3], 100)
    assert (graded.mark, graded.words) == (100, "all cases are right")


@pytest.mark.parametrize("number", LESSONS)
def test_the_class_to_complete_has_the_mark_that_the_notebook_shows(number, file):
    (notebook,) = NOTEBOOKS.glob(f"{number}_*.ipynb")
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    (source,) = ("".join(cell["source"]) for cell in cells if "%%writefile" in cell["source"][0])
    file.write_text(source.partition("\n")[2])
    cases = solution_in(number)[0] if number in QUICK else cases_of(number)
    graded = marked(file, lesson_of(number), cases, 100)
    assert not graded.passed
    (mark,) = (cell for cell in cells if "graded = grade(" in "".join(cell["source"]))
    shown = "".join(mark["outputs"][0]["text"])
    assert shown.endswith(f"{graded.mark} of 100: {graded.words}\n")


def test_solutions_that_are_parts_pass_the_checks_of_parts():
    back_end, navigation = (runpy.run_path(str(solution_of(number))) for number in (3, 7))
    testing.check_back_end(back_end["BackEnd"])
    testing.check_planner(navigation["GlobalPlanner"])
    testing.check_controller(navigation["Controller"])


def test_a_case_that_the_solution_does_not_solve_is_not_set(file):
    strict = dataclasses.replace(lesson_of(2), good=0.0025)
    solution, _ = solved_cases(strict, "")
    usual, _ = solution_in(2)
    assert max(one.error for one in usual) > 0.0025 >= max(one.error for one in solution)
    file.write_text(changed(*MATCH, "return guess"))
    assert marked(file, strict, solution, 10).mark == 0


@pytest.mark.parametrize(("method", "body", "words"), WRONG)
def test_a_wrong_solution_is_told_what_is_wrong(method, body, words, file):
    file.write_text(changed(*method, body))
    graded = marked(file, lesson_of(method[0]), [first_case(method[0])], 20)
    assert not graded.passed
    assert words in graded.words
    assert "\n" not in graded.words


@pytest.mark.parametrize(
    ("name", "number"), [*((name, 2) for name in UNUSABLE), *(("empty", number) for number in LESSONS)]
)
def test_a_file_that_cannot_be_asked_has_mark_0(name, number, file):
    text, words = (part.format(name=CLASS[number], number=number) for part in UNUSABLE[name])
    file.write_text(text)
    graded = marked(file, lesson_of(number), [first_case(number)], 1)
    assert graded.mark == 0
    assert words in graded.words
    assert "\n" not in graded.words


@pytest.mark.parametrize("name", ["empty", "prints"])
def test_it_has_a_page_one_line_and_exit_1(name, file, tmp_path, capsys):
    text, words = (part.format(name="ScanMatcher", number=2) for part in UNUSABLE[name])
    file.write_text(text)
    assert main(["grade", str(file), "--lesson", "2", "--out", str(tmp_path / "out"), "-q"]) == 1
    said = capsys.readouterr().out
    assert said.startswith(f"lesson 2: 0 of 100, not passed; {words}")
    assert said.count("\n") == 1
    assert "0 of 100" in (tmp_path / "out/index.html").read_text()
    assert json.loads((tmp_path / "out/metrics.json").read_text())["mark"] == 0


@pytest.mark.parametrize("number", LESSONS)
def test_each_page_shows_the_result_beside_the_right_one(number, file, tmp_path):
    file.write_text("import os\n")
    graded = marked(file, lesson_of(number), [first_case(number)], 5)
    page = grade_page(graded, "hw.py", tmp_path / "figures")
    assert f"Lesson {number}: {lesson_of(number).title}" in page
    assert (tmp_path / "figures/visible-1.svg").stat().st_size > 5000


def test_the_same_file_and_salt_give_the_same_bytes_also_with_two_threads(file, tmp_path, monkeypatch):
    # Right for scans that turn left, and it says where an object is, which differs from run to run.
    body = (
        "print('hello')\n        if guess[2] < 0: raise ValueError(object())\n"
        "        return super().match(points_a, points_b, guess)"
    )
    file.write_text(changed(*MATCH, body))
    for threads in "12":
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        words = ["grade", str(file), "--lesson", "2", "--salt", "s", "--out", str(tmp_path / threads), "-q"]
        main(words)
    assert sha256_tree(tmp_path / "1") == sha256_tree(tmp_path / "2")
    mark = json.loads((tmp_path / "1/metrics.json").read_text())["mark"]
    assert 0 < mark < 100
    assert mark % 10 == 0
    assert "hello" in (tmp_path / "1/index.html").read_text()


def test_lessons_that_do_not_drive_need_no_bullet():
    makes = f"import sys; from {grade.__module__} import lesson_of"
    for number in range(2, 7):
        makes += f"; lesson_of({number}).visible(); print('pybullet' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", makes], capture_output=True, text=True, check=True)
    assert run.stdout == "False\n" * 5


def test_a_file_that_sleeps_is_ended_and_time_that_passes_between_questions_is_not_its_own(file, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    file.write_text(changed(*ODOMETRY, "import time; time.sleep(60 * left); return [0, 0, 0]"))
    with Pupil(file, lesson_of(1).wanted, 1) as pupil:
        pupil.begin()
        pupil.new("WheelOdometry", **first_case(1).case.new)
        now_s[0] = 1000.0
        time.sleep(1.0)
        assert pupil.ask("update", (3,), left=0.0, right=0.0).tolist() == [0.0, 0.0, 0.0]
        threading.Timer(0.5, lambda: now_s.__setitem__(0, 2000.0)).start()
        with pytest.raises(Ended, match="it did not end"):
            pupil.ask("update", (3,), left=1.0, right=0.0)


def test_what_is_asked_again_is_sent_once_to_each_object(file):
    body = "same = left is getattr(self, 'seen', None); self.seen = left; return [same, sum(left), 0]"
    file.write_text(changed(*ODOMETRY, body))
    array = np.ones(3)
    with Pupil(file, lesson_of(1).wanted) as pupil:
        pupil.begin()
        for _ in range(2):
            pupil.new("WheelOdometry", **first_case(1).case.new)
            answers = [pupil.ask("update", (3,), left=array, right=0.0).tolist() for _ in range(2)]
            assert answers == [[0.0, 3.0, 0.0], [1.0, 3.0, 0.0]]
            with pytest.raises(Fault, match="TypeError"):
                pupil.new("WheelOdometry", nothing=1)


def test_another_salt_has_other_hidden_cases_and_the_same_visible_ones():
    lesson = lesson_of(2)
    a, b = ([case.truth.tolist() for case in lesson.hidden(salt)] for salt in ("a", "b"))
    assert not any(truth in b for truth in a)
    assert [case.truth.tolist() for case in lesson.visible()] == [c.truth.tolist() for c in lesson.visible()]


def test_the_process_of_the_file_has_neither_salt_nor_truth_nor_solutions(file):
    names = "sorted(name for name in sys.modules if name.startswith('turtlebag.'))"
    said = f"print(*{names}, *sys.argv, *os.environ.values())"
    for number in LESSONS:
        file.write_text(
            changed(number, CLASS[number], "unused(self)", "pass") + f"\n\nimport os, sys\n{said}\n"
        )
        with Pupil(file, lesson_of(number).wanted) as pupil:
            pupil.begin()
        assert CLASS[number] in pupil.printed
        loaded = {name for name in pupil.printed.split() if name.startswith("turtlebag.pipeline.course")}
        assert loaded <= {"turtlebag.pipeline.course", "turtlebag.pipeline.course.solutions"}


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
    file.write_text("")
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
