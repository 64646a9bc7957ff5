"""The whole `make demo` killed at random moments and started again (see benchmarks.kills --demo).

It runs in a copy of the working tree, with the virtual environment of this one, so that set-up is not
part of it. One undisturbed demo says what every file has to hash to and how long it takes. Each kill
starts from nothing: SIGKILL to make and all that it started, then `make demo` again, which has to finish
with the same bytes in every file but the manifests, and to leave nothing half done behind.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np

from turtlebag.datasets.outputs import sha256_tree

ROOT = Path(__file__).parents[1]
LEFT_OUT = shutil.ignore_patterns(".venv", "data", ".git", ".hypothesis", ".mypy_cache", ".ruff_cache")
LEFT_BEHIND = (".partial", ".old-", ".turtlebag-")


def copy_of_the_tree(folder: Path) -> Path:
    """The sources (compiled kernels too) in a folder of their own, with this environment's packages."""
    shutil.copytree(ROOT, folder, ignore=LEFT_OUT)
    (folder / ".venv").mkdir()
    environment = (ROOT / ".venv").resolve()
    shutil.copy(environment / "pyvenv.cfg", folder / ".venv")
    for part in ("bin", "lib"):
        (folder / ".venv" / part).symlink_to(environment / part)
    (folder / ".venv" / ".ready").touch()
    return folder


def start_demo(folder: Path) -> subprocess.Popen[bytes]:
    """`make demo` of that copy, as the leader of a process group."""
    # The environment's own console script would import the tree that it was installed from.
    command = ["make", "demo", "TURTLEBAG=.venv/bin/python -m pipeline"]
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
    with (folder / "demo.log").open("ab") as log:
        return subprocess.Popen(
            command, cwd=folder, env=environment, stdout=log, stderr=log, start_new_session=True
        )


def made(folder: Path) -> dict[str, str]:
    """sha256 of every file of the demo but the manifests, what is kept to save work and what was set aside.

    The bag of a killed drive is kept as OUT.unfinished: there is data in it.
    """
    found = sha256_tree(folder / "data")
    kept = [name for name in found if not name.startswith("cache/") and ".unfinished/" not in name]
    return {name: found[name] for name in kept}


def one_kill(folder: Path, after_s: float, wanted: dict[str, str]) -> str:
    """Outcome of a demo killed after `after_s` seconds and started again."""
    shutil.rmtree(folder / "data", ignore_errors=True)
    process = start_demo(folder)
    try:
        process.wait(after_s)
        return f"finished before the kill, exit {process.returncode}"
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    stages = sum(1 for _ in (folder / "data").glob("*/*/manifest.json"))
    code = start_demo(folder).wait()
    if code != 0:
        return f"BAD: exit {code} when started again; see {folder}/demo.log"
    found = made(folder)
    different = sorted(name for name, _ in set(found.items()) ^ set(wanted.items()))
    if different:
        return f"BAD: {len(different)} files differ, first {different[0]}"
    left = [
        path.name for path in (folder / "data").rglob("*") if any(part in path.name for part in LEFT_BEHIND)
    ]
    return f"BAD: left behind {', '.join(left)}" if left else f"killed after {stages} stages: same bytes"


def demo_kills(count: int, seed: int, folder: Path) -> list[tuple[str, str, str]]:
    """("demo", moment [s], outcome) of each kill, in a copy of the tree made at `folder`."""
    copy_of_the_tree(folder)
    begun = time.perf_counter()
    if start_demo(folder).wait() != 0:
        raise SystemExit(f"make demo fails undisturbed; see {folder}/demo.log")
    took, wanted = time.perf_counter() - begun, made(folder)
    print(f"undisturbed: {took:.0f} s, {len(wanted)} files", flush=True)
    rng, rows = np.random.default_rng(seed), []
    while len(rows) < count:
        after_s = float(rng.uniform(0.0, took))
        outcome = one_kill(folder, after_s, wanted)
        print(f"demo, {after_s:.0f} s: {outcome}", flush=True)
        if outcome.startswith("finished before"):
            took *= 0.9  # the machine is less busy than it was
        else:
            rows.append(("demo", f"{after_s:.3f}", outcome))
    return rows
