"""Installed as anybody installs a package: from the index, beside Hugging Face's `datasets`; then the chain.

python -m benchmarks.install [--python PYTHON] [--out DIR]

A sdist is built of the checkout and a wheel of the sdist. A fresh virtual environment gets the wheel with
all that it asks for, then `datasets`; the installed command records, maps, navigates and reports in
an empty folder, twice: the first time compiles the numeric kernels.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.runner import ROOT, Row, options, write
from turtlebag.pipeline.setup.short_chain import SCRIPT

NOT_COPIED = (".*", "__pycache__", "*.egg-info", "build", "data", "dist", "docs", "tests")
CHAIN = {
    "record": "--world turtlebot3_world --teleop trial.yaml --seed 1 --out rec",
    "map": "rec --truth rec/truth --out map",
    "navigate": "--world turtlebot3_world --task goal --goal=-1.8,-0.5,0 --map map/map.yaml "
    "--initial-pose start --out run",
    "report": "run --no-animation --out report",
}
BESIDE = "import datasets, turtlebag, turtlebag.datasets; assert datasets.Dataset is not None"


def built(folder: Path) -> Path:
    """The wheel of a copy of the checkout; `folder` gets the sdist that it is made of, too."""
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "checkout"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*NOT_COPIED))
        run([sys.executable, "-m", "build", "--no-isolation", "--outdir", folder.absolute(), copy], copy)
    (wheel,) = folder.glob("*.whl")
    return wheel


def chain(environment: Path, folder: Path, **variables: str) -> Iterator[tuple[str, float]]:
    """Record, map, navigate and report with the command of a virtual environment: (stage, seconds) of each.

    `folder` is where; only the installed package can be imported.
    """
    (folder / "trial.yaml").write_text(SCRIPT)
    for stage, words in CHAIN.items():
        yield stage, run([environment / "bin/turtlebag", stage, *words.split()], folder, **variables)[1]


def run(command: Sequence[str | Path], folder: Path, **variables: str) -> tuple[str, float]:
    """What a command prints when run in a folder, and its wall time [s]; RuntimeError when it fails."""
    ours = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    begin = time.monotonic()
    done = subprocess.run(
        command, cwd=folder, env={**ours, **variables}, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}:\n{done.stdout}{done.stderr}")
    return done.stdout, time.monotonic() - begin


def measure(python: str, folder: Path) -> Iterator[Row]:
    """A row for each step, with its wall time."""
    environment, beside = folder / "environment", folder / "beside"
    beside.mkdir()
    pip = [environment / "bin/python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    begin = time.monotonic()
    wheel = built(folder / "dist")
    yield {"step": "sdist and wheel", "seconds": time.monotonic() - begin}
    for step, command in {
        "python -m venv": [python, "-m", "venv", environment],
        "pip install dist/*.whl": [*pip, wheel],
        "pip install datasets": [*pip, "datasets"],
        "both are imported": [environment / "bin/python", "-c", BESIDE],
    }.items():
        yield {"step": step, "seconds": run(command, beside)[1]}
    for which in ("first", "again"):
        place = folder / which
        place.mkdir()
        for stage, seconds in chain(environment, place):
            yield {"step": f"turtlebag {stage}, {which}", "seconds": seconds}


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--python", default=sys.executable, help="Python to install for")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        rows = list(measure(args.python, Path(name)))
    write(args.out, "install", rows)


if __name__ == "__main__":
    main()
