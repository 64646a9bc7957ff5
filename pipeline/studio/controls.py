"""What a page asks of the server and not of the session: when time passes, what to send, who drives."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.studio.inputs import KNOWN, Input, parse_input

MESSAGE_BYTES = 64 * 1024


def _zero_or_more_than_a_tenth(factor: float) -> float:
    if 0.0 < factor < 0.1:
        raise ValueError("must be 0 or from 0.1 to 100")
    return factor


class Pause(Settings):
    """Let the simulated time stand still."""

    do: Literal["pause"] = "pause"


class Resume(Settings):
    """Let it go on."""

    do: Literal["resume"] = "resume"


class Step(Settings):
    """One tick, while it stands still."""

    do: Literal["step"] = "step"


class Speed(Settings):
    """Simulated seconds a second; 0: as fast as it goes."""

    do: Literal["speed"] = "speed"
    factor: Annotated[
        float, Field(ge=0.0, le=100.0, allow_inf_nan=False), AfterValidator(_zero_or_more_than_a_tenth)
    ]


class Layers(Settings):
    """What this client wants to be sent. The page has layers of its own, too: unknown names do nothing."""

    do: Literal["layers"] = "layers"
    layers: Annotated[list[Annotated[str, Field(max_length=64)]], Field(max_length=64)]


class TakeControl(Settings):
    """This client drives from now on."""

    do: Literal["take_control"] = "take_control"


Control = Pause | Resume | Step | Speed | Layers | TakeControl
_CONTROLS: TypeAdapter[Control] = TypeAdapter(Annotated[Control, Field(discriminator="do")])
_NAMES = tuple(model.model_fields["do"].default for model in get_args(Control))


class Malformed(Exception):
    """A message that no page of ours sends."""


def parse_message(message: str | bytes) -> Control | Input:
    """What a client's message asks for.

    Malformed for what no page of ours sends; InputError, in one line, for values that cannot be.
    """
    if not isinstance(message, str):
        raise Malformed("messages are text")
    if len(message.encode()) > MESSAGE_BYTES:
        raise Malformed(f"a message has at most {MESSAGE_BYTES // 1024} KiB")
    try:
        data: Any = json.loads(message)
    except (ValueError, RecursionError):
        raise Malformed("a message is a JSON object") from None
    do = data.get("do") if isinstance(data, dict) else None
    if not isinstance(do, str) or do not in (*_NAMES, *KNOWN):
        raise Malformed("a message has a `do` that is known here")
    if do in KNOWN:
        return parse_input(data, where="page")
    try:
        return _CONTROLS.validate_python(data)
    except ValidationError as error:
        raise InputError(f"{do}: {error.errors(include_input=False)[0]['msg']}") from None
