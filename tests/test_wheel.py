"""What others install: the wheel holds all of the package and nothing else, and works where no checkout is.

The packages it needs are those of the environment that runs the tests, so nothing is fetched:
`make bench-install` runs the last test, which installs them from the index.
"""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

from turtlebag.datasets import kernels
from turtlebag.pipeline.setup.trial_run import SCRIPT

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCK = [Requirement(line) for line in (ROOT / "requirements.lock").read_text().splitlines()]
ROOMS = {
    "turtlebag": "pipeline/turtlebag",
    **{f"turtlebag/{name}": name for name in ("datasets", "pipeline", "planners", "reports", "sim")},
}
NOT_COPIED = (".*", "__pycache__", "*.egg-info", "build", "data", "dist", "docs", "tests")
CHAIN = {
    "record": "--world turtlebot3_world --teleop trial.yaml --seed 1 --out rec",
    "map": "rec --truth rec/truth --out map",
    "navigate": "--world turtlebot3_world --task goal --goal=-1.8,-0.5,0 --map map/map.yaml "
    "--initial-pose start --out run",
    "report": "run --no-animation --out report",
}
BESIDE = "import datasets, turtlebag, turtlebag.datasets; assert datasets.Dataset is not None"
WHERE = """
import datasets, turtlebag, turtlebag.datasets as ours
print(datasets.__file__, turtlebag.__file__, ours.__file__)
"""
# In one process, which imports everything once: most of what the commands of such a short chain do.
STAGES = """
import sys
from turtlebag.pipeline.cli.main import main
for words in sys.argv[1:]:
    assert main(words.split()) == 0, words
"""


def built(folder):
    """The wheel of a copy of the checkout; `folder` gets the sdist that it is made of, too."""
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "checkout"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*NOT_COPIED))
        run([sys.executable, "-m", "build", "--no-isolation", "--outdir", folder.absolute(), copy], copy)
    (wheel,) = folder.glob("*.whl")
    return wheel


def run(command, folder, **variables):
    """What a command prints when run in a folder; only installed packages can be imported there."""
    ours = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        command, cwd=folder, env={**ours, **variables}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{' '.join(map(str, command))}:\n{done.stdout}{done.stderr}"
    return done.stdout


def kernels_for(packages, scratch):
    """The checkout's compiled kernels, named as numba names those of the package installed in `packages`."""
    kept = scratch / "kept/kernels" / kernels.folder().name
    for package, room in ROOMS.items():
        for path in (ROOT / room).rglob("*.py"):
            ours, theirs = path.parent, packages / package / path.relative_to(ROOT / room).parent
            names = [f"{x.name}_{hashlib.sha1(str(x).encode()).hexdigest()}" for x in (ours, theirs)]
            if (kernels.folder() / names[0]).is_dir():
                shutil.copytree(kernels.folder() / names[0], kept / names[1], dirs_exist_ok=True)
    return scratch / "kept"


def package_files():
    """Every file of the checkout that belongs to the package, by its path in the package."""
    for package, folder in ROOMS.items():
        for path in (ROOT / folder).rglob("*"):
            inside = path.relative_to(ROOT / folder)
            # What is imported as turtlebag stands in a folder of the command line's package.
            nested = folder == "pipeline" and inside.parts[0] == "turtlebag"
            if path.is_file() and "__pycache__" not in path.parts and not nested:
                yield f"{package}/{inside.as_posix()}"


@pytest.mark.slow
def test_the_wheel_works_in_an_empty_folder_beside_another_package_called_datasets(tmp_path):
    dist, environment, empty = tmp_path / "dist", tmp_path / "environment", tmp_path / "empty"
    wheel = built(dist)
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    info = {
        name for name in names if name.startswith(f"turtlebag-{PROJECT['project']['version']}.dist-info/")
    }
    assert names - info == set(package_files())
    (sdist,) = dist.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        assert {Path(name).parts[1] for name in archive.getnames() if "/" in name} >= {"LICENSE", "README.md"}

    empty.mkdir()
    run([sys.executable, "-m", "venv", "--without-pip", environment], empty)
    python = environment / "bin/python"
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--no-deps",
        "--no-index",
        "--no-compile",
    ]
    run([*pip, wheel], empty)
    packages = next(environment.glob("lib/python*/site-packages"))
    (packages / "datasets.py").touch()
    (packages / "theirs.pth").write_text(sysconfig.get_path("purelib"))
    imported = run([python, "-c", WHERE], empty)
    assert [Path(file).relative_to(packages).as_posix() for file in imported.split()] == [
        "datasets.py",
        "turtlebag/__init__.py",
        "turtlebag/datasets/__init__.py",
    ]
    worlds = run([environment / "bin/turtlebag", "world", "list"], empty)
    assert "turtlebot3_world" in worlds
    (empty / "trial.yaml").write_text(SCRIPT)
    stages = [f"{stage} {words}" for stage, words in CHAIN.items()]
    run([python, "-c", STAGES, *stages], empty, NUMBA_CACHE_DIR=str(kernels_for(packages, tmp_path)))
    assert "turtlebot3_world" in (empty / "report/index.html").read_text()


def test_the_lock_has_one_version_of_each_package_in_the_range_that_is_asked_for():
    pins = {
        canonicalize_name(line.name): line for line in LOCK if line.marker is None or line.marker.evaluate()
    }
    extras = PROJECT["project"]["optional-dependencies"]
    todo = [Requirement(line) for line in PROJECT["project"]["dependencies"] + extras["dev"] + extras["docs"]]
    todo = [wanted for wanted in todo if wanted.marker is None or wanted.marker.evaluate()]
    assert all("==" not in str(wanted.specifier) for wanted in todo)
    seen = set()
    while todo:  # and what those need, and so on
        wanted = todo.pop()
        name = canonicalize_name(wanted.name)
        (version,) = re.fullmatch(r"==([\w.]+)", str(pins[name].specifier)).groups()
        assert wanted.specifier.contains(version), wanted
        if name not in seen:
            seen.add(name)
            needs = [Requirement(line) for line in metadata.requires(name) or ()]
            if name == "open3d-cpu":  # the others are for its figures in a browser: see open3d_loader
                needs = [need for need in needs if need.name == "numpy"]
            todo += [need for need in needs if need.marker is None or need.marker.evaluate({"extra": ""})]
    assert seen == set(pins)


X86, ARM = ("linux", "x86_64"), ("linux", "aarch64")
MAC, INTEL_MAC = ("darwin", "arm64"), ("darwin", "x86_64")
ON_SOME = {
    "pybullet": {X86},
    "open3d-cpu": {X86},
    "open3d": {ARM, MAC},
    "ompl": {X86, ARM},
    "kiss-icp": {X86, ARM, MAC},
}


@pytest.mark.parametrize("place", [X86, ARM, MAC, INTEL_MAC], ids="-".join)
def test_a_platform_is_asked_only_for_packages_that_have_wheels_there(place):
    here = {"sys_platform": place[0], "platform_machine": place[1]}
    asked, every = set(), set()
    for line in map(Requirement, PROJECT["project"]["dependencies"]):
        every.add(line.name)
        if line.marker is None or line.marker.evaluate(here):
            asked.add(line.name)
    assert every - asked == {name for name, places in ON_SOME.items() if place not in places}


WITHOUT_FIGURES = """
import sys
from importlib import abc
class Missing(abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in ("dash", "plotly", "IPython", "flask", "werkzeug", "nbformat"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Missing())
sys.modules["dash"] = None
from turtlebag.datasets.open3d_loader import open3d
import numpy as np
cloud = open3d().geometry.PointCloud(open3d().utility.Vector3dVector(np.eye(3)))
print(len(cloud.points), sys.modules.get("dash"))
"""


@pytest.mark.slow
def test_open3d_needs_no_package_of_its_figures_in_a_browser(tmp_path):
    assert run([sys.executable, "-c", WITHOUT_FIGURES], tmp_path) == "3 None\n"


def test_the_dockerfile_is_the_commands_of_the_readme():
    (start,) = re.findall(r"^## Start\n+```\n(.*?)^```", (ROOT / "README.md").read_text(), re.M | re.S)
    commands = [line.partition(" #")[0].strip() for line in start.splitlines()]
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    assert [line[4:] for line in lines if line.startswith("RUN make ")] == commands[:1]
    assert [json.loads(line[4:]) for line in lines if line.startswith("CMD ")] == [commands[1].split()]
    python = re.search(r"^FROM python:([\d.]+)", "\n".join(lines), re.M)[1]
    assert SpecifierSet(PROJECT["project"]["requires-python"]).contains(python)
    (told,) = re.findall(r"Python ([\d.]+) or newer", (ROOT / "README.md").read_text())
    assert PROJECT["project"]["requires-python"] == f">={told}"


@pytest.mark.skipif("TURTLEBAG_INSTALL_FOR" not in os.environ, reason="from the index: make bench-install")
def test_the_chain_works_installed_from_the_index_beside_hugging_face_s_datasets(tmp_path):
    environment, empty = tmp_path / "environment", tmp_path / "empty"
    empty.mkdir()
    run([os.environ["TURTLEBAG_INSTALL_FOR"], "-m", "venv", environment], empty)
    pip = [environment / "bin/python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    run([*pip, built(tmp_path / "dist"), "datasets"], empty)
    run([environment / "bin/python", "-c", BESIDE], empty)
    (empty / "trial.yaml").write_text(SCRIPT)
    for stage, words in CHAIN.items():
        run([environment / "bin/turtlebag", stage, *words.split()], empty)
    assert "turtlebot3_world" in (empty / "report/index.html").read_text()
