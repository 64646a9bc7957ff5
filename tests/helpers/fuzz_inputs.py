"""Inputs broken in seeded ways, and what every command has to do with them."""

from __future__ import annotations

import contextlib
import copy
import json
import os
import random
import resource
import signal
import tempfile
import traceback
from pathlib import Path

import yaml
from numba.core.event import Listener, install_listener

from turtlebag.pipeline.cli.main import main

WILD = [
    None, "", "x", "\u00e9\n\x00", "nan", True, False, 0, -1, 1, 3, 10**30, 10**400, 0.5, -0.0, 1e-300, 1e300,
    -1e300, float("nan"), float("inf"), [], {}, [[]], [0], [0, 0], [1, 2, 3], [float("nan")] * 3,
    [1e300, -1e300, 1e300], {"x": 1}, ["x", None], [[0, 0], [0, 0], [0, 0]], "{x}", "'", "../..", "/dev/null",
]  # fmt: skip
WILD_WORDS = [
    "nan",
    "inf",
    "-inf",
    "1e400",
    "-1",
    "0",
    "x",
    "",
    "9" * 40,
    "-1e-300",
    "1e300",
    "0x1",
    "\u0661",
]


def places(tree, path=()):
    """Paths of every value in nested lists and mappings."""
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in children:
        yield (*path, key)
        yield from places(value, (*path, key))


def tree_broken(rng, tree):
    """A copy with one to three values replaced, removed, repeated, scaled or added."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        found = list(places(tree))
        if not found:
            break
        *way, last = rng.choice(found)
        node = tree
        for key in way:
            node = node[key]
        action, value = rng.randrange(8), node[last]
        if action == 0:
            del node[last]
        elif action == 1 and isinstance(node, list):
            node.append(copy.deepcopy(value))
        elif action == 2 and isinstance(node, dict):
            node["unknown"] = rng.choice(WILD)
        elif action == 3 and isinstance(value, (int, float)):
            node[last] = value * rng.choice([-1, 0, 0.01, 2, 100, 1e6])
        elif action == 4:
            node[last] = [value]
        else:
            node[last] = copy.deepcopy(rng.choice(WILD))
    return tree


def bytes_broken(rng, data):
    """The bytes with one to four cuts, flips, blanks, insertions or repetitions."""
    data = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(data)) if data else 0
        size = rng.choice([1, 4, 16, 200])
        action = rng.randrange(6)
        if action == 0 and rng.random() < 0.3:
            del data[at:]
        elif action == 1 and data:
            data[at] ^= 1 << rng.randrange(8)
        elif action == 2:
            data[at : at + size] = bytes(len(data[at : at + size]))
        elif action == 3:
            data[at:at] = rng.randbytes(size)
        elif action == 4:
            del data[at : at + size]
        else:
            data[at:at] = data[at : at + size]
    return bytes(data)


def words_broken(rng, text):
    """The text with one to three of its words or lines replaced, removed or repeated."""
    lines = [line.split(" ") for line in text.split("\n")]
    for _ in range(rng.randint(1, 3)):
        index = rng.randrange(len(lines))
        line, action = lines[index], rng.randrange(6)
        if action == 0 and len(lines) > 1:
            del lines[index]
        elif action == 1:
            lines.insert(rng.randrange(len(lines)), list(line))
        elif action == 2:
            del line[rng.randrange(len(line)) :]
        else:
            line[rng.randrange(len(line))] = rng.choice(WILD_WORDS)
    return "\n".join(" ".join(line) for line in lines)


class Unbroken(random.Random):
    """The choices of a variant of which nothing is broken."""


def broken(rng, path):
    """Break one file in place, in the way of its kind or byte by byte."""
    if isinstance(rng, Unbroken):
        return
    data = path.read_bytes()
    structured = rng.random() < 0.75
    if structured and path.suffix in (".yaml", ".json") and data:
        tree = tree_broken(rng, yaml.safe_load(data.decode()))
        text = json.dumps(tree) if path.suffix == ".json" else yaml.safe_dump(tree, sort_keys=False)
        path.write_text(text)
    elif structured and path.suffix in (".tum", ".csv", ".log", ".relations", ".g2o", ".world", ".sdf"):
        path.write_text(words_broken(rng, data.decode()))
    else:
        path.write_bytes(bytes_broken(rng, data))


class TooSlow(BaseException):
    """A command that would not end in time, as every variant must: what a person waits for, or kills."""


WAITING = 60
"""Times the computing time that a command may take by the clock, on a machine however busy."""

AGAIN = 0.5
"""Seconds after which it is stopped once more: what calls back from C swallows exceptions."""


class Uncounted(Listener):
    """Stops the clock while kernels are compiled: that is done once, by whichever variant comes first."""

    def __init__(self):
        self.depth, self.left = 0, 0.0

    def on_start(self, event):
        self.depth += 1
        if self.depth == 1:
            self.left = signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)[0]

    def on_end(self, event):
        self.depth -= 1
        if self.depth == 0:
            signal.setitimer(signal.ITIMER_VIRTUAL, self.left, AGAIN)


@contextlib.contextmanager
def limits(seconds, waiting, memory_bytes=6 << 30):
    """Stop what computes for longer, or waits for ever, by TooSlow; too much memory is a MemoryError."""

    def stop(number, frame):
        raise TooSlow

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = {number: signal.signal(number, stop) for number in (signal.SIGVTALRM, signal.SIGALRM)}
    resource.setrlimit(resource.RLIMIT_AS, (used + memory_bytes, hard))
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds, AGAIN)
    signal.setitimer(signal.ITIMER_REAL, waiting * seconds, AGAIN)
    try:
        with install_listener("numba:compile", Uncounted()):
            yield
    finally:
        for timer in (signal.ITIMER_VIRTUAL, signal.ITIMER_REAL):
            signal.setitimer(timer, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        for number, handler in before.items():
            signal.signal(number, handler)


def outcome(words, seconds=5.0, *, command=main, waiting=WAITING):
    """Exit code of a command line and all it said on stderr; a traceback's code is None, TooSlow's -1."""
    with tempfile.TemporaryFile("w+") as said, contextlib.redirect_stderr(said):
        saved = os.dup(2)
        os.dup2(said.fileno(), 2)
        code = None
        try:
            with (
                limits(seconds, waiting),
                open(os.devnull, "w") as nowhere,
                contextlib.redirect_stdout(nowhere),
            ):
                code = command([str(word) for word in words])
        except TooSlow:
            code = -1
        except (Exception, SystemExit):
            traceback.print_exc(file=said)
        finally:
            said.flush()
            os.dup2(saved, 2)
            os.close(saved)
        said.seek(0)
        return code, said.read()


def complaint(words, place, seconds=5.0, **how):
    """What is wrong with how a command line ended that writes below the empty folder `place`; "" is well.

    In time, exit 0, 1 or 2; with 2 one line on stderr that names the program, and `place` still empty.
    """
    code, text = outcome(words, seconds, **how)
    if code == -1:
        return f"it computes for more than {seconds:g} s, or waits for ever"
    if code not in (0, 1, 2) or "Traceback" in text or "Warning: " in text:
        return f"exit {code}: {text}"
    if code != 2:
        return ""
    if not text.startswith("turtlebag: ") or text.count("\n") != 1:
        return f"exit 2 and not one line: {text!r}"
    if len(text) > 1500:
        return f"a line of {len(text)} characters: {text[:300]}"
    left = sorted(path.name for path in place.iterdir())
    return f"exit 2 and left behind: {left} ({text.strip()})" if left else ""


def with_output(words, place):
    """The command line with `--out` below `place` where the command writes something."""
    if words[0] == "verify" or words[:2] in (["bag", "info"], ["bag", "doctor"]):
        return words
    return [*words, "--out", str(place / ("out.png" if words[0] == "world" else "out"))]


def attempt(case, make, chain, seed, seconds=5.0):
    """Complaint about one seeded variant of one case, in a folder that is removed afterwards.

    `make(rng, chain, scratch)` writes the broken inputs to `scratch` and gives the command line but `--out`.
    """
    rng = random.Random(f"{case} {seed}")
    with tempfile.TemporaryDirectory() as name:
        scratch, place = Path(name) / "in", Path(name) / "out"
        scratch.mkdir()
        place.mkdir()
        words = with_output(make(rng, chain, scratch), place)
        found = complaint(words, place, seconds)
    return f"{case} {seed}: {' '.join(map(str, words))}\n{found}" if found else ""
