"""The pages of the site that are generated: all commands by `--help`, all settings, the glossary."""

import ast
import inspect
import io
import re
import textwrap
from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from functools import cache
from itertools import pairwise
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from pydantic import BaseModel

from turtlebag.pipeline.cli.main import VERBS, build_parser
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.slam3d.slam3d import Slam3dConfig
from turtlebag.pipeline.stages.localise import LocaliseConfig
from turtlebag.pipeline.stages.record import RecordConfig
from turtlebag.reports.glossary import WORDS

CONFIGS: dict[str, type[BaseModel]] = {
    "`record`, `teleop`": RecordConfig,
    "`map`": SlamConfig,
    "`map`, from point clouds": Slam3dConfig,
    "`localise`": LocaliseConfig,
    "`navigate`, `plan`": NavigateConfig,
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Three pages more."""
    files.append(File.generated(config, "commands.md", content="".join(commands())))
    files.append(File.generated(config, "settings.md", content="".join(settings())))
    files.append(File.generated(config, "glossary.md", content="".join(glossary())))
    return files


def shown(*words: str) -> str:
    """The help of a command, or of an action of one."""
    with redirect_stdout(io.StringIO()) as text, suppress(SystemExit):
        build_parser(words[0]).parse_args([*words, "--help"])
    return text.getvalue()


def commands() -> Iterator[str]:
    """The page of all commands."""
    yield "# Commands\n\nWhat `--help` says.\n"
    for verb in VERBS:
        text = shown(verb)
        yield f"\n## turtlebag {verb}\n\n```text\n{text}```\n"
        listed = text.partition("\n  ACTION\n")[2]
        for action in re.findall(r"^    ([a-z]+)(?:  |$)", listed, re.M):
            yield f"\n### turtlebag {verb} {action}\n\n```text\n{shown(verb, action)}```\n"


def glossary() -> Iterator[str]:
    """The words that reports explain."""
    yield "# Glossary\n\nThe words of the reports. [Concepts](concepts.md) puts them together.\n"
    for word in sorted(WORDS, key=lambda word: word.name.lower()):
        yield f"\n**{word.name}**: {word.meaning}\n"


def settings() -> Iterator[str]:
    """The page of all settings."""
    yield "# Settings\n\nThe keys of `--set` and [settings files](formats/config.md), with their defaults.\n"
    for title, model in CONFIGS.items():
        yield f"\n## {title}\n\n| key | default | |\n|---|---|---|\n"
        for key, value, text in rows(model):
            yield f"| `{key}` | {value} | {text} |\n"


def rows(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Key, default and description of each setting of a model and of those in it."""
    for name, field in model.model_fields.items():
        if field.is_required():  # an option of the command
            continue
        default: Any = field.get_default(call_default_factory=True)
        if isinstance(default, BaseModel):
            yield from rows(type(default), f"{prefix}{name}.")
            continue
        value = "" if default is None else f"`{default}`"
        text = field.description or next(filter(None, (documented(one).get(name) for one in model.mro())), "")
        yield f"{prefix}{name}", value, " ".join(text.split()).replace("|", "\\|")


@cache
def documented(model: type) -> dict[str, str]:
    """The docstrings that stand below the fields of a class."""
    if not issubclass(model, BaseModel) or model is BaseModel:
        return {}
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    assert isinstance(tree, ast.ClassDef)
    return {
        field.target.id: text.value.value
        for field, text in pairwise(tree.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }
