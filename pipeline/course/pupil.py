"""The process of a student's file: it has the limits, the questions of the cases, and nothing else of ours.

Run as `python -m turtlebag.pipeline.course.pupil`. Questions and answers are lines of JSON; arrays travel as
lists. A question {"new": {...}} makes an object of the class, {"call": {...}} calls its method.
"""

from __future__ import annotations

import importlib.util
import json
import random
import resource
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

ANSWER_CHARACTERS = 200
"""Of what an error says."""


def limit(memory_mb: int, cpu_s: int) -> None:
    """Hard limits for this process, which it cannot raise again."""
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform.startswith("linux"):  # elsewhere it is refused
        size = memory_mb * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (size, size))


def load(source: Path) -> ModuleType:
    """The file as a module; what stands beside it can be imported."""
    sys.path.insert(0, str(source.parent))
    spec = importlib.util.spec_from_file_location("submission", source)
    if spec is None or spec.loader is None:
        raise ImportError("it is not a Python file: its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["submission"] = module
    spec.loader.exec_module(module)
    return module


def fault_of(error: BaseException, source: Path) -> str:
    """What was raised, and in which line of the file."""
    lines = [
        frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(source)
    ]
    if isinstance(error, SyntaxError) and error.filename == str(source):
        lines = [error.lineno]
    where = f" (line {lines[-1]})" if lines else ""
    try:
        words = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())
    except Exception:
        words = ""
    return f"{type(error).__name__}: {words[:ANSWER_CHARACTERS]}{where}"


def arrays(given: dict[str, Any]) -> dict[str, Any]:
    """The same with arrays in place of lists."""
    return {name: np.array(one, float) if isinstance(one, list) else one for name, one in given.items()}


def numbers(value: Any, method: str) -> Any:
    """What was returned, as nested lists of numbers."""
    if value is None:
        raise TypeError(f"{method} returned nothing")
    try:
        return np.asarray(value, dtype=float).tolist()
    except (TypeError, ValueError):
        raise TypeError(f"{method} returned {type(value).__name__}, not an array of numbers") from None


def serve(source: Path, name: str, method: str, questions: Any, answers: Any) -> None:
    """Answer until there are no more questions."""

    def say(answer: dict[str, Any]) -> None:
        answers.write(json.dumps(answer) + "\n")
        answers.flush()

    try:
        module = load(source)
        wanted = getattr(module, name, None)
        if not isinstance(wanted, type):
            raise LookupError(f"the file has no class {name}")
        if not callable(getattr(wanted, method, None)):
            raise LookupError(f"the class {name} has no method {method}")
    except BaseException as error:
        say({"fault": str(error.args[0]) if type(error) is LookupError else fault_of(error, source)})
        return
    say({"ready": True})
    made: Any = None
    for line in questions:
        asked = json.loads(line)
        try:
            if "new" in asked:
                np.random.seed(0)  # noqa: NPY002 (what students use)
                random.seed(0)
                made, value = wanted(**arrays(asked["new"])), None
            else:
                value = numbers(getattr(made, method)(**arrays(asked["call"])), method)
            say({"value": value})
        except BaseException as error:
            say({"fault": fault_of(error, source)})


def main(words: list[str]) -> None:
    """`SOURCE CLASS METHOD MEMORY_MB CPU_S QUESTIONS ANSWERS`; the last two are open file descriptors."""
    source, name, method, memory_mb, cpu_s, questions, answers = words
    limit(int(memory_mb), int(cpu_s))
    with open(int(questions)) as asked, open(int(answers), "w") as said:
        serve(Path(source), name, method, asked, said)


if __name__ == "__main__":
    main(sys.argv[1:])
