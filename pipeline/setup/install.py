"""Makes the virtual environment for make: `python3 pipeline/setup/install.py FOLDER`.

It runs when there is nothing but Python, so it imports the standard library alone. An interrupted set-up is
recognised by its mark and started again; one that fails gives the reason in one line, and pip's own output is
kept.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

UNFINISHED = ".unfinished"
READY = ".ready"
LOG = "install.log"
# The lock file is complete, so nothing has to be resolved. Compiling is a separate step, on every core, for
# our own sources too: if Python may not write bytecode, each process would compile them again.
PIP = (
    "-m",
    "pip",
    "install",
    "--no-deps",
    "--no-compile",
    "--quiet",
    "--disable-pip-version-check",
    "--no-input",
)
COMPILE = ("-m", "compileall", "-qq", "-j", "0", "-x", "/tests/")
NO_ANSWER = re.compile(
    r"Retrying \(|ConnectionError|TimeoutError|NameResolutionError|ProxyError|SSLError|ProtocolError"
    r"|IncompleteRead|HTTP error 5\d\d|\b5\d\d Server Error|timed out"
)
AGAIN = "then run the same make command again"


class Failed(Exception):
    """The set-up cannot be finished; the text says why and what to do in one line."""


class Broken(Failed):
    """It cannot be finished in the environment that was found."""


# Names the packages with missing files; those of caches and scripts may be missing.
WHOLE = """
import importlib.metadata as metadata, sys
bad = set()
for package in metadata.distributions(path=[path for path in sys.path if path.startswith(sys.prefix)]):
    files = package.files
    kept = [file for file in files or () if file.suffix != ".pyc" and file.parts[0] != ".."]
    if files is None or not all(file.locate().exists() for file in kept):
        bad.add(str(package.metadata["Name"]))
print(", ".join(sorted(bad)))
"""


def install(environment: Path, project: Path) -> None:
    """Install the packages of the project's lock file, and the project, in `environment`; Failed gives the
    reason.

    Remains of an interrupted set-up, and a damaged environment, are removed first.
    """
    with _alone(environment) as handle:
        found = any(environment.iterdir()) and not (environment / UNFINISHED).exists()
        if not found:
            _clear(environment)
        try:
            _fill(environment, project, handle)
        except Broken as error:
            if not found:
                raise
            print(f"set-up: {error}; recreating {environment.name}", flush=True)
            _clear(environment)
            _fill(environment, project, handle)
        print("set-up: trial run, which compiles the numeric kernels", flush=True)
        if subprocess.run([environment / "bin/turtlebag", "doctor", "--trial"], check=False).returncode:
            raise Failed(f"the lines above show what does not work; fix it, {AGAIN}")


@contextmanager
def _alone(environment: Path) -> Iterator[int]:
    """Holds the folder's lock, waiting for the process that has it: pip may outlive a killed make."""
    environment.mkdir(exist_ok=True)
    handle = os.open(environment, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(
                f"set-up: another set-up is running in {environment.name}; waiting for it to finish",
                flush=True,
            )
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield handle
    finally:
        os.close(handle)


def _clear(environment: Path) -> None:
    """A folder that is empty except for the mark, which exists at every moment."""
    (environment / UNFINISHED).touch()
    for path in environment.iterdir():
        if path.name == UNFINISHED:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _fill(environment: Path, project: Path, handle: int) -> None:
    """Virtual environment, packages, project; the mark exists from the first change to the last."""
    log, lock = environment / LOG, project / "requirements.lock"
    python = str(environment / "bin/python")
    if (environment / "pyvenv.cfg").exists() and (damaged := _damaged(python)):
        raise Broken(f"what is in {environment.name} is damaged ({damaged})")
    (environment / UNFINISHED).touch()
    (environment / READY).unlink(missing_ok=True)
    log.write_text("")
    print(f"set-up: creating a virtual environment in {environment.name}", flush=True)
    what = "the virtual environment could not be made"
    _run([sys.executable, "-m", "venv", str(environment)], log, what, handle)
    packages = sum(bool(line.strip()) for line in lock.read_text().splitlines())
    print(f"set-up: {packages} packages (takes some minutes, only this once)", flush=True)
    what = "the packages could not be installed"
    _run([python, *PIP, "-r", str(lock)], log, what, handle)
    own = ("--no-build-isolation", "--editable", str(project))
    _run([python, *PIP, *own], log, what, handle)
    put_on_path(environment, project)
    sources = [str(environment / "lib"), *map(str, project.glob("[!.]*"))]
    with suppress(Failed):  # a file for another Python; whoever imports it is told
        _run([python, *COMPILE, *sources], log, "the sources could not be compiled", handle)
    (environment / UNFINISHED).unlink()


def put_on_path(environment: Path, project: Path) -> None:
    """Put `turtlebag` on Python's path too.

    The finder of an editable install is asked last: in a folder that contains a clone named turtlebag, the
    clone would be taken for the package.
    """
    link = environment.resolve() / "lib/checkout/turtlebag"
    link.parent.mkdir(parents=True, exist_ok=True)
    link.unlink(missing_ok=True)
    link.symlink_to(project.resolve() / "pipeline/turtlebag")
    for packages in environment.glob("lib/python*/site-packages"):
        (packages / "turtlebag.pth").write_text(f"{link.parent}\n")


def _damaged(python: str) -> str:
    """The defects of an environment's packages: missing files; empty if there are none."""
    try:
        done = subprocess.run([python, "-I", "-c", WHOLE], capture_output=True, text=True, check=False)
    except OSError as error:
        return f"its Python: {error.strerror}"
    return " ".join(done.stdout.split()) or ("its Python does not run" if done.returncode else "")


def _run(command: Sequence[str], log: Path, what: str, handle: int) -> None:
    """Run a command, which also holds the lock `handle`, with its output in the log; Failed gives the
    reason."""
    said: list[str] = []
    with (
        subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            pass_fds=(handle,),
        ) as process,
        log.open("a") as kept,
    ):
        for line in process.stdout or ():
            kept.write(line)
            if "Retrying (" in line and not NO_ANSWER.search("".join(said)):
                print(f"set-up: no answer from {mirror()}; trying again (Ctrl-C to give up)", flush=True)
            said.append(line)
    if process.returncode:
        raise Failed(f"{_reason(said, what, process.returncode)} (full output: {log.parent.name}/{log.name})")


def _reason(said: Sequence[str], what: str, code: int) -> str:
    text = "".join(said)
    if NO_ANSWER.search(text) or ("(from versions: none)" in text and "Ignored the following" not in text):
        wanted = re.findall(r"No matching distribution found for (\S+)", text)
        package = f" with {wanted[-1]}" if wanted else ""
        return (
            f"{mirror()} does not answer{package}: check the network, or name a package mirror that does, "
            f"make setup PIP_INDEX_URL=https://...; {AGAIN}"
        )
    if code < 0:
        return f"{what}: stopped by signal {-code}; {AGAIN}"
    errors = [line for line in said if line.startswith(("ERROR:", "Error:"))]
    last = (errors or [line for line in said if line.strip()] or [f"exit {code}"])[-1].strip()
    return f"{what}: {last.removeprefix('ERROR: ')}; {AGAIN}"


def mirror() -> str:
    """Where pip looks for packages, without a password."""
    url = os.environ.get("PIP_INDEX_URL") or _configured() or "https://pypi.org/simple"
    parts = urlsplit(url)
    return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()


def _configured() -> str:
    asked = [sys.executable, "-m", "pip", "config", "get", "global.index-url"]
    return subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip()


def main() -> int:
    """0 done, 2 failed, with one line that gives the reason, 130 interrupted."""
    try:
        install(Path(sys.argv[1]), Path(__file__).resolve().parents[2])
    except Failed as error:
        print(f"set-up: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"set-up: {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("set-up: interrupted; run make again to resume", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
