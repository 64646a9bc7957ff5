"""Makes the virtual environment for make: `python3 pipeline/setup/install.py FOLDER`.

It runs when there is nothing but Python, so it imports the standard library alone. pip fetches uv, and uv the
packages, in a fraction of pip's time. A set-up that fails says why in one line, and its whole output is kept;
after one that failed or was killed all is made anew.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

LOG, WHOLE, READY = "install.log", ".whole", ".ready"  # the last is make's
# Seconds after which a step says that it still runs.
STILL_S = 15.0
AGAIN = "then run the same make command again"
UV = "uv>=0.9,<1"
PIP = ("-m", "pip", "install", "--quiet", "--no-compile", "--disable-pip-version-check", "--no-input")
# Data, libraries and tests of the packages that nothing of ours reads: 400 MB. Of Babel's
# languages, English and the root are read.
UNUSED = (
    "pybullet_data", "pybullet_envs", "eglRenderer.*", "gtsam/Data", "open3d/resources",
    "open3d/open3d_*_ops.so", "babel/locale-data/[!er]*", "material/templates/.icons/simple",
    "zstandard/_cffi.*", "**/tests",
)  # fmt: skip
# What uv does not read by itself of pip's settings, which may stand in its files too.
OF_PIP = {
    "index-url": "UV_DEFAULT_INDEX", "extra-index-url": "UV_INDEX", "find-links": "UV_FIND_LINKS",
    "cert": "SSL_CERT_FILE", "trusted-host": "UV_INSECURE_HOST",
}  # fmt: skip


class Failed(Exception):
    """The set-up cannot be finished; the text says why and what to do in one line."""


def install(environment: Path, project: Path, handle: int) -> None:
    """Install the packages of the project's lock file, and the project, in `environment`; Failed gives the
    reason. `handle` is the folder's lock, which every child holds too: one may outlive a killed make.
    """
    found = (environment / WHOLE).exists()
    for mark in (WHOLE, READY):  # first, as clearing takes a while and may be killed
        (environment / mark).unlink(missing_ok=True)
    for path in () if found else environment.iterdir():
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    (environment / LOG).write_text("")
    settings = settings_of_pip()
    index = urlsplit(settings.get("UV_DEFAULT_INDEX") or "https://pypi.org/simple")
    mirror = index._replace(netloc=index.netloc.rpartition("@")[2]).geturl()  # without a password
    python, lock = str(environment / "bin/python"), project / "requirements.lock"
    fetched = (
        f"could not be fetched from {mirror}: check the network, or name a package mirror that answers, "
        "make setup PIP_INDEX_URL=https://..."
    )

    def run(said: str, command: list[str], wrong: str) -> None:
        print(f"set-up: {said}", flush=True)
        with (environment / LOG).open("a+") as log:
            env = {**os.environ, **settings}
            process = subprocess.Popen(command, stdout=log, stderr=log, pass_fds=(handle,), env=env)
            if code := waited(process, said.partition(" (")[0]):
                log.seek(0)
                errors = re.findall(r"^(?:ERROR|error): *(.*)", log.read(), re.M | re.I)
                why = errors[0] if errors else f"stopped by signal {-code}" if code < 0 else f"exit {code}"
                raise Failed(f"{wrong} ({why}); {AGAIN} (full output: {environment.name}/{LOG})")

    if not found:
        venv = [sys.executable, "-m", "venv", str(environment)]
        run(f"creating a virtual environment in {environment.name}", venv, "it could not be made")
        run(f"fetching uv from {mirror}", [python, *PIP, UV], f"uv {fetched}")
    uv = [str(environment / "bin/uv"), "pip", "install", "--python", python, "--no-deps"]
    count = len(lock.read_text().split("\n")) - 1
    run(f"{count} packages (some minutes the first time)", [*uv, "-r", str(lock)], f"the packages {fetched}")
    own = ["--no-build-isolation", "--editable", str(project)]
    run("turtlebag itself", [*uv, *own], "turtlebag itself could not be installed")
    put_on_path(environment, project)
    for packages in environment.glob("lib/python*/site-packages"):
        for path in [path for name in UNUSED for path in packages.glob(name)]:
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()
    trial(environment, project)
    (environment / WHOLE).touch()


def trial(environment: Path, project: Path) -> None:
    """Compile what will be run: our sources, what they import of the packages, and the numeric kernels.

    Where Python may not write bytecode, each process would compile the sources again.
    """
    compileall = [str(environment / "bin/python"), "-m", "compileall", "-qq", "-j", "0", "-x", "/tests/"]
    subprocess.run([*compileall, *map(str, project.glob("[!.]*"))], check=False)
    print("set-up: trial run, which compiles the numeric kernels", flush=True)
    env = {**os.environ, "PYTHONDONTWRITEBYTECODE": ""}
    doctor = subprocess.Popen([environment / "bin/turtlebag", "doctor", "--trial"], env=env)
    if waited(doctor, "trial run"):
        raise Failed(f"the lines above show what does not work; fix it, {AGAIN}")


def waited(process: subprocess.Popen[bytes], said: str) -> int:
    """The exit code of a process; every now and then a line tells that it still runs."""
    begin = time.monotonic()
    with process:
        while True:
            try:
                return process.wait(STILL_S)
            except subprocess.TimeoutExpired:
                print(f"set-up: {said}: {time.monotonic() - begin:.0f} s", flush=True)
            except BaseException:
                process.terminate()
                raise


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


def settings_of_pip() -> dict[str, str]:
    """pip's settings as uv's variables, its environment before its files; uv's own variables stay."""
    asked = [sys.executable, "-m", "pip", "config", "list"]
    said = subprocess.run(asked, capture_output=True, text=True, check=False).stdout
    found = {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # as pip does, all indices are asked
    for name, value in re.findall(r"^[\w:]+\.([\w-]+)='(.*)'$", said, re.M):
        if name in OF_PIP and OF_PIP[name] not in os.environ:
            found.setdefault(OF_PIP[name], value)
    return found


def main() -> int:
    """0 done, 2 failed, with one line that gives the reason, 130 interrupted."""
    environment = Path(sys.argv[1])
    try:
        environment.mkdir(exist_ok=True)
        handle = os.open(environment, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"set-up: another set-up is running in {environment.name}; waiting for it", flush=True)
            fcntl.flock(handle, fcntl.LOCK_EX)
        install(environment, Path(__file__).resolve().parents[2], handle)
    except Failed as error:
        print(f"set-up: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"set-up: {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("set-up: interrupted; run make again", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
