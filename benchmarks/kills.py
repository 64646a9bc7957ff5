"""Stages killed at random moments and started again.

python -m benchmarks.kills [--count 190] [--quick] [--only STAGE ...] [--seed 0] [--out DIR]

A small chain with every command that writes (kills.yaml) is made once undisturbed. Then each is killed with
SIGKILL at moments drawn evenly over its length, and the same command is given again: it has to
finish, and every file but manifest.json has to have the bytes of the undisturbed run. Every stage runs in a
process of its own, forked after the imports, so that the moments fall into the stage's work and not into its
start. (What a killed recording leaves is recovered by tests/datasets/test_bag_damage.py.)
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import yaml

from benchmarks.runner import options, write
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.pipeline.cli.main import main as turtlebag

Outcome = tuple[str, str, str]
"""Stage, moment of the kill [s], and what came of it."""
DONE = (0, 1)
"""Exit codes of complete outputs; a drive of some seconds does not reach everything."""
READ = ("record", "map", "navigate", "record3d")
"""Stages that others read."""
CHAIN = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())


def load_everything() -> None:
    """Import every module once, for the forks to find it loaded."""
    for name in ("datasets", "sim", "planners", "reports", "pipeline"):
        package = importlib.import_module(f"turtlebag.{name}")
        for module in pkgutil.walk_packages(package.__path__, f"turtlebag.{name}."):
            # Of what `turtlebag` itself lies in, `envs` needs a package that is not always there.
            if not module.name.endswith(("__main__", ".envs")):
                importlib.import_module(module.name)


def command(chain: Path, stage: str, out: Path) -> list[str]:
    """The command line of a stage that reads its inputs from `chain`."""
    verb, *words = CHAIN["commands"][stage].replace("CHAIN", str(chain)).split()
    return [verb, "-q", *words, "--out", str(out)]


def hashes(out: Path) -> dict[str, str]:
    """sha256 of an output's files but its manifest, by path; a single file is called nothing."""
    found = sha256_tree(out)
    return {"": found[out.name]} if out.is_file() else found


def start(words: list[str], errors: Path) -> int:
    """Fork a process (and group) that runs the command line with stderr in a file; returns its pid."""
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        code = 70
        try:
            os.setsid()
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
            code = turtlebag(words)
        except BaseException as error:
            os.write(2, f"{type(error).__name__}: {error}\n".encode())
        finally:
            os._exit(code)
    return pid


def finish(pid: int) -> int:
    """Exit code of a child, or minus the signal that ended it."""
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def undisturbed(chain: Path, only: Sequence[str]) -> dict[str, float]:
    """Make the chain; seconds each stage of `only` (empty: all) takes, measured on a second run of it."""
    for name, content in CHAIN["files"].items():
        (chain / name).write_text(yaml.safe_dump(content, sort_keys=False).replace("CHAIN", str(chain)))
    took = {}
    for stage in CHAIN["commands"]:
        if only and stage not in {*only, *READ}:
            continue
        again = [chain / "again" / stage] if stage in only or not only else []
        for out in (chain / stage, *again):
            begun = time.perf_counter()
            code = finish(start(command(chain, stage, out), chain / "stderr"))
            if code not in DONE:
                raise SystemExit(f"{stage}: exit {code}: {(chain / 'stderr').read_text().strip()}")
            took[stage] = time.perf_counter() - begun
        if not again:
            del took[stage]
        elif hashes(chain / stage) != hashes(chain / "again" / stage):
            raise SystemExit(f"{stage}: two undisturbed runs differ")
    return took


def one_kill(chain: Path, stage: str, after_s: float, folder: Path) -> str:
    """Outcome of a stage killed after `after_s` seconds and started again."""
    out, errors = folder / stage, folder / "stderr"
    words = command(chain, stage, out)
    pid = start(words, errors)
    time.sleep(after_s)
    os.killpg(pid, signal.SIGKILL) if os.getpgid(pid) == pid else os.kill(pid, signal.SIGKILL)
    code = finish(pid)
    if code != -signal.SIGKILL:
        return "finished before the kill" if code in DONE else f"BAD: exit {code} undisturbed"
    whole = out.exists()
    if not whole:
        code = finish(start(words, errors))
        if code not in DONE:
            return f"BAD: exit {code} when started again: {errors.read_text().strip()}"
    different = dict(hashes(out).items() ^ hashes(chain / stage).items())
    if different:
        return f"BAD: other bytes than undisturbed: {', '.join(sorted(different))}"
    left = {path.name for path in folder.iterdir()} - {stage, "stderr", f"{stage}.unfinished"}
    if left:
        return f"BAD: left behind {', '.join(sorted(left))}"
    return "killed after the last step, whole" if whole else "killed, started again: same bytes"


def kills(chain: Path, took: dict[str, float], count: int, seed: int) -> Iterator[Outcome]:
    """`count` real kills; runs that were quicker than the kill are extra."""
    rng = np.random.default_rng(seed)
    for number, stage in enumerate(took):
        wanted = (count + number) // len(took)
        while wanted:
            after_s = float(rng.uniform(0.0, took[stage]))
            with tempfile.TemporaryDirectory() as name:
                outcome = one_kill(chain, stage, after_s, Path(name))
            yield stage, f"{after_s:.3f}", outcome
            if outcome == "finished before the kill":
                took[stage] *= 0.95  # the machine is less busy than it was
            else:
                wanted -= 1


def main() -> int:
    parser = options(__doc__, quick="one kill each", count=190, seed=0)
    stages = CHAIN["commands"]
    parser.add_argument(
        "--only", nargs="+", default=[], choices=stages, metavar="STAGE", help="kill these alone"
    )
    args = parser.parse_args()
    load_everything()
    with tempfile.TemporaryDirectory() as name:
        chain = Path(name)
        took = undisturbed(chain, args.only)
        print(", ".join(f"{stage} {seconds:.2f} s" for stage, seconds in took.items()), flush=True)
        found = [*kills(chain, took, len(took) if args.quick else args.count, args.seed)]
    names = ("stage", "after_s", "outcome")
    write(args.out, "kills", [dict(zip(names, one, strict=True)) for one in found], show=False)
    counts = Counter((stage, outcome.partition(";")[0]) for stage, _, outcome in found)
    write(args.out, "kills-summary", [{"n": n, "stage": s, "outcome": o} for (s, o), n in counts.items()])
    return int(any(outcome.startswith("BAD") for _, _, outcome in found))


if __name__ == "__main__":
    sys.exit(main())
