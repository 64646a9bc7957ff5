"""The process of a student's file: it has the limits, the questions of the cases, and nothing else of ours.

Run as `python -m turtlebag.pipeline.course.pupil`. Questions are pickled, answers lines of JSON: nothing of a
student's is ever unpickled. A question "new" makes an object of a class, "call" calls a method of one.
"""

from __future__ import annotations

import importlib.util
import json
import pickle
import random
import resource
import sys
import traceback
from contextlib import suppress
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


def numbers(value: Any, method: str) -> Any:
    """What was returned, as nested lists of numbers; also of a pose, poses, a plan or a twist."""
    if value is None:
        raise TypeError(f"{method} returned nothing")
    array = getattr(getattr(value, "poses", value), "xyt", value)
    try:
        array = (value.v, value.w) if hasattr(value, "w") else array
        return np.asarray(array, dtype=float).tolist()
    except (TypeError, ValueError, AttributeError):
        raise TypeError(f"{method} returned {type(value).__name__}, not an array of numbers") from None


def classes_of(module: ModuleType, wanted: dict[str, list[str]]) -> dict[str, type]:
    """The classes to ask; LookupError for one that is not there, or has no such method."""
    for name, methods in wanted.items():
        made = getattr(module, name, None)
        if not isinstance(made, type):
            raise LookupError(f"the file has no class {name}")
        for method in methods:
            if not callable(getattr(made, method, None)):
                raise LookupError(f"the class {name} has no method {method}")
    return {name: getattr(module, name) for name in wanted}


def serve(source: Path, wanted: dict[str, list[str]], questions: Any, answers: Any) -> None:
    """Answer until there are no more questions."""

    def say(answer: dict[str, Any]) -> None:
        answers.write(json.dumps(answer) + "\n")
        answers.flush()

    try:
        classes = classes_of(load(source), wanted)
    except BaseException as error:
        say({"fault": str(error.args[0]) if type(error) is LookupError else fault_of(error, source)})
        return
    say({"ready": True})
    made: dict[str, Any] = {}
    unpickler = pickle.Unpickler(questions)
    with suppress(EOFError):
        while asked := unpickler.load():
            if "new" in asked:
                unpickler = pickle.Unpickler(questions)
            try:
                say({"value": reply(classes, made, wanted, **asked)})
            except BaseException as error:
                say({"fault": fault_of(error, source)})


def reply(
    classes: dict[str, type],
    made: dict[str, Any],
    wanted: dict[str, list[str]],
    given: dict[str, Any],
    new: str = "",
    call: str = "",
    mute: bool = False,
) -> Any:
    """The answer to one question; what is `made` is kept by the names of its methods."""
    if not new:
        value = getattr(made[call], call)(**given)
        return None if mute else numbers(value, call)
    np.random.seed(0)  # noqa: NPY002 (what students use)
    random.seed(0)
    made |= dict.fromkeys(wanted[new], classes[new](**given))
    return None


def main(words: list[str]) -> None:
    """`SOURCE WANTED MEMORY_MB CPU_S QUESTIONS ANSWERS`; the last two are open file descriptors."""
    source, wanted, memory_mb, cpu_s, questions, answers = words
    limit(int(memory_mb), int(cpu_s))
    sys.modules["turtlebag.pipeline.course.solutions"] = None  # type: ignore[assignment]  # no import finds them
    with open(int(questions), "rb") as asked, open(int(answers), "w") as said:
        serve(Path(source), json.loads(wanted), asked, said)


if __name__ == "__main__":
    main(sys.argv[1:])
