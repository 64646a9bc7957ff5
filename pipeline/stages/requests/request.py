"""What a stage is asked for: every option, said once.

A request is what the command line's options are generated from (`command_line`), what `import turtlebag`
and campaigns make, what a manifest records, and what `verify` runs again (`stages.run`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import ValidationError, field_validator, model_validator

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import plain_message, read_mapping
from turtlebag.pipeline.stages.requests.options import class_name

Place = Callable[[str | Path], str | Path]
MAPS = ("map", "keepout")
"""Fields that may be a map yaml, which names an image."""


class Request(Settings):
    """What one stage is asked for: nothing of where its output goes, or how it is called."""

    VERB: ClassVar[str]
    EXAMPLE: ClassVar[str]

    @classmethod
    def checked(cls, **given: Any) -> Self:
        """The request of these fields; InputError names the first that is wrong, in one line."""
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            if first["type"] == "extra_forbidden":
                known = ", ".join(cls.model_fields)
                raise InputError(f"{where}: {cls.VERB} has no such option (known: {known})") from None
            raise InputError(f"{where}: {plain_message(first)}") from None

    @model_validator(mode="before")
    @classmethod
    def _of_a_twin(cls, given: Any) -> Any:
        """Of a world that is the folder of a twin its world and robot, and for the studio its map."""
        world = given.get("world") if isinstance(given, dict) else None
        folder, clutter, things = str(world).partition("+clutter:")
        if not isinstance(world, str | os.PathLike) or not os.path.isfile(os.path.join(folder, "world.yaml")):
            return given
        own = {"robot": "robot.yaml", **({"map": "map/map.yaml"} if cls.VERB == "studio" else {})}
        files = {name: os.path.join(folder, file) for name, file in own.items()}
        found = {
            name: file for name, file in files.items() if given.get(name) is None and os.path.isfile(file)
        }
        return {**given, **found, "world": os.path.join(folder, "world.yaml") + clutter + things}

    @field_validator("*", mode="before")
    @classmethod
    def _from_python(cls, value: Any) -> Any:
        """Of a class its name, of what is path-like its path."""
        if isinstance(value, os.PathLike):
            return Path(value)
        if isinstance(value, list | tuple):
            return [cls._from_python(one) for one in value]
        return class_name(value)

    def recorded(self) -> dict[str, Any]:
        """What a manifest says of it: every field, and in place of a settings file what that said."""
        fields = dict(self)
        if isinstance(fields.get("config"), Path):
            fields["config"] = read_mapping(fields["config"])
        whole = type(self).model_construct(**{name: _finite(value) for name, value in fields.items()})
        return {"verb": self.VERB, **whole.model_dump(mode="json")}

    def files(self) -> list[Path]:
        """The existing files and folders that it names, and the images of maps: what the stage may read.

        A word may be the name of something built in; only a file of that name is meant as a file.
        """
        fields = dict(self)
        named = [value for value in fields.values() if isinstance(value, str) and os.path.isfile(value)]
        images = [image for name in MAPS for image in _images(fields.get(name))]
        world = _world_files(fields.get("world"))
        return [
            path for path in (*_paths(fields), *map(Path, named), *images, *world) if os.path.exists(path)
        ]

    def moved(self, place: Place) -> Self:
        """The same request with other paths, and other names of what may be a file."""
        return type(self).model_validate({name: _moved(value, place) for name, value in dict(self).items()})


def _images(path: Any) -> list[Path]:
    """The image of a map yaml; none of anything else, which the stage refuses or reads otherwise."""
    if not isinstance(path, Path):
        return []
    from turtlebag.datasets.maps import map_files  # heavy, and needed anyway where there is a map

    with suppress(InputError):
        return [map_files(path)["map_image"]]
    return []


def _world_files(name: Any) -> list[Path]:
    """The files of a world that is one of the user's, with its options; none of anything else."""
    if not isinstance(name, str) or not os.path.isfile(name.partition("+clutter:")[0].partition(":")[0]):
        return []
    from turtlebag.sim.worlds import own_files

    with suppress(InputError):
        return [*own_files(name, None).values()]
    return []


def _paths(value: Any) -> Iterator[Path]:
    if isinstance(value, Path):
        yield value
    elif isinstance(value, tuple | dict):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _paths(one)


def _finite(value: Any) -> Any:
    """JSON has no numbers that are not finite: their names, which settings take as well."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_finite(one) for one in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _moved(value: Any, place: Place) -> Any:
    if isinstance(value, str | Path):
        return place(value)
    if isinstance(value, dict):
        return {key: _moved(one, place) for key, one in value.items()}
    return tuple(_moved(one, place) for one in value) if isinstance(value, tuple) else value
