"""A small campaign, of stages that know their answer at once."""

from functools import partial
from pathlib import Path
from typing import Annotated

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.command_line import read
from turtlebag.pipeline.stages.requests.options import Option
from turtlebag.pipeline.stages.requests.request import Request

CAMPAIGN = """
name: small
question: Does it?
factors:
  size: [1, 2, 3]
  kind: {plain: "", strange: "--odd 'two words'"}
  seed: {first: 1, last: 4}
stages:
  make: "fake --size {size} --seed {seed} {kind}"
  check: "fake --size {size} --of {make}/metrics.json"
results: {error_m: {at: "make:error.rmse", label: error, unit: cm}, good: "check:good"}
compare: size
against: 1
figures:
  - {x: size, y: error_m, lines: kind}
  - {x: size, y: good, panels: kind}
"""
UNDRAWN = CAMPAIGN.partition("figures:")[0]
"""The same without pictures, which take longer than all of its cases."""


class Fake(Request):
    """What a stage is asked for that only counts."""

    VERB = "fake"
    EXAMPLE = "turtlebag fake --size 1 --out data/fake"

    size: Annotated[int, Option("N", "its size", "1", read=int)]
    seed: Annotated[int, Option("N", "its seed", "1", read=int)] = 0
    of: Annotated[Path | None, Option("FILE", "what it reads", "m.json", read=Path)] = None
    odd: Annotated[str | None, Option("TEXT", "how odd it is", "very")] = None
    world: Annotated[str | None, Option("W", "where it is", "there")] = None


read_fake = partial(read, kinds={"fake": Fake})


def fake(asked: Fake, out: Output) -> int:
    """Stands in for the stages: one that knows its answer at once."""
    if asked.size == 99:
        raise RuntimeError("a defect")
    if asked.size == 98:
        raise InputError("bad size 98")
    with out.staged() as folder:
        (folder / "big.bin").write_bytes(b"0" * 100)
        error = (0.1 + 0.001 * asked.seed) * asked.size
        out.finish(folder, "fake", {}, metrics={"error": {"rmse": error}, "good": asked.size < 3})
    return 0


FAKES = {"run": fake, "read": read_fake}
