"""What `--help` shows, as a person reads it."""

import functools
import io
import re
from contextlib import redirect_stdout

from turtlebag.pipeline.cli.main import build_parser


@functools.cache
def shown(*words):
    """The help of a verb, or of an action of one."""
    with redirect_stdout(io.StringIO()) as text:
        try:
            build_parser(words[0]).parse_args([*words, "--help"])
        except SystemExit:
            return text.getvalue()
    raise AssertionError("help is the end of a command")


def options(*words):
    """Its options: for each, what stands for its value, "" where it takes none."""
    found = re.findall(r"^  (?:(-\w), )?(--[\w-]+)(?: (\S+))?(?:  |$)", shown(*words), re.M)
    return {name: value for *names, value in found for name in names if name}


def actions(verb):
    """Its actions, if it has any."""
    _, _, listed = shown(verb).partition("\n    ")
    return set(re.findall(r"^(?:    )?([a-z]+)  ", listed, re.M)) if "\n  ACTION\n" in shown(verb) else set()
