"""Requests as the options, the words and the text of a command line: generated from their fields."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar, get_args, get_origin

from pydantic import ValidationError
from pydantic.fields import FieldInfo

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.yaml_files import parsed, plain_message
from turtlebag.pipeline.stages.parser import Parser, joined, refuse_former
from turtlebag.pipeline.stages.requests.options import Laser, Option, flag_of
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.pipeline.stages.requests.table import REQUESTS

Asked = TypeVar("Asked", bound=Request)


def add_request(parser: Parser, kind: type[Request]) -> None:
    """An option for each field of a request, its own before those that it shares with others; what is not
    given is not in the namespace."""
    for name in sorted(kind.model_fields, key=lambda name: name not in kind.__annotations__):
        field = kind.model_fields[name]
        _add_field(parser, name, field, option_of(field))


def _add_field(parser: Parser, name: str, field: FieldInfo, option: Option) -> None:
    again = "; may be repeated" if _repeated(field) and not option.positional else ""
    words: dict[str, Any] = {"help": f"{said_of(field)}{again}", "default": argparse.SUPPRESS}
    if not option.positional:
        words |= {"dest": name, "required": field.is_required()}
    if field.annotation is bool:
        action = "store_false" if field.default else "store_true"
        parser.add_argument(flag(name, option), action=action, **{**words, "required": False})
        return
    words |= {"type": option.read} | ({"metavar": option.value} if option.value else {})
    words |= {"choices": option.choices} if option.choices else {}
    if _repeated(field):
        words |= {"nargs": "+"} if option.positional else {"action": "append"}
    parser.add_argument(name if option.positional else flag(name, option), **words)


def option_of(field: FieldInfo) -> Option:
    """What a field of a request says of itself."""
    return next(one for one in field.metadata if isinstance(one, Option))


def flag_of_field(request: Request, name: str) -> str:
    """The option of a request's field."""
    return flag(name, option_of(type(request).model_fields[name]))


def flag(name: str, option: Option) -> str:
    """The option of a request's field by its name."""
    return option.name or flag_of(name)


def _repeated(field: FieldInfo) -> bool:
    return get_origin(field.annotation) is dict or ... in get_args(field.annotation)


def said_of(field: FieldInfo) -> str:
    """What a field is, in what unit, and its default, in a line."""
    option, value = option_of(field), field.default
    unit = f" [{option.unit}]" if option.unit else ""
    told = isinstance(value, str | int | float) and not isinstance(value, bool)
    return f"{option.text}{unit}" + (f" (default: {value})" if told else "")


def request_of(kind: type[Asked], args: argparse.Namespace) -> Asked:
    """The request that a command line makes; InputError names the option that is wrong."""
    given = {name: value for name, value in vars(args).items() if name in kind.model_fields}
    try:
        return kind.model_validate(given)
    except ValidationError as error:
        first = error.errors()[0]
        name, *places = first["loc"] or ("",)
        value = given.get(str(name))
        if isinstance(value, list) and places and isinstance(places[0], int):
            value = value[places[0]]
        option = flag(str(name), option_of(kind.model_fields[str(name)]))
        raise InputError(f"{option} {value}: {plain_message(first)}") from None


@cache
def _parser(verb: str, kind: type[Request]) -> Parser:
    parser = Parser(prog=f"turtlebag {verb}", add_help=False)
    noise = parser.add_mutually_exclusive_group()
    noise.add_argument("-q", "--quiet", action="store_true")
    noise.add_argument("-v", "--verbose", action="store_true")
    add_request(parser, kind)
    parser.add_output(required=False)
    return parser


def read(words: Sequence[str], kinds: Mapping[str, type[Request]] = REQUESTS) -> Request:
    """The request of a command line, without its `turtlebag`; InputError for one that makes none."""
    verb = next((verb for verb in kinds if verb.split() == [*words[: len(verb.split())]]), None)
    if verb is None:
        refuse_former(next(iter(words), None))
        raise InputError(f"invalid choice: {' '.join(words[:1])!r} (choose from {', '.join(kinds)})")
    kind = kinds[verb]
    return request_of(kind, _parser(verb, kind).parse_args(joined(words[len(verb.split()) :])))


def words_of(request: Request) -> list[str]:
    """The command line, without its output, that makes a request."""
    words, options = [*request.VERB.split()], []
    for name, field in type(request).model_fields.items():
        option, value = option_of(field), getattr(request, name)
        if option.positional:
            texts = map(_word, value if _repeated(field) else [value])
            words += [f"./{text}" if text.startswith("-") else text for text in texts]
        elif isinstance(value, bool):
            options += [flag(name, option)] if value != field.default else []
        elif isinstance(value, dict):  # settings, or what a file of them says
            options += [word for held in value.items() for word in ("--set", _setting(*held))]
        elif value is not None and value != field.default:
            said = flag(name, option)
            for text in map(_word, value if _repeated(field) else [value]):
                options += [f"{said}={text}"] if text.startswith("-") else [said, text]
    return [*words, *options]


def recorded(request: Request, out: Output) -> Output:
    """The output with what its manifest is to say was asked for."""
    command = out.command or ["turtlebag", *words_of(request), "--out", str(out.folder)]
    return replace(out, command=command, request=request.recorded())


def _setting(key: str, value: Any) -> str:
    plain = isinstance(value, str) and bool(value) and parsed(value, where=key) == value
    return f"{key}={value if plain else json.dumps(value)}"


def _word(value: Any) -> str:
    """A value as the command line takes it, numbers with all their digits."""
    if isinstance(value, Laser):
        return ",".join([*map(repr, value[:3]), *(["upside-down"] if value.upside_down else [])])
    if isinstance(value, tuple) and isinstance(value[0], str):
        name, held = value
        return f"{name}={_word(held)}" if name else _word(held)
    if isinstance(value, tuple):
        return ",".join(map(repr, value))
    return repr(value) if isinstance(value, float) else str(value)
