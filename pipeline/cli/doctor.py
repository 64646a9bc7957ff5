"""`turtlebag doctor`: imports every required package and does a little work with it."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import version

from turtlebag.pipeline.setup.missing_package import INSTALL, WHOLE, WITHOUT, without
from turtlebag.pipeline.stages.parser import Parser

EXAMPLE = "turtlebag doctor --trial"


def add_arguments(parser: Parser) -> None:
    """The command's arguments."""
    text = "also record, map and drive for a few seconds (the first time compiles the numeric kernels)"
    parser.flag("--trial", text)


def run(args: argparse.Namespace) -> int:
    """Make all checks, with --trial also that one."""
    return report({**CHECKS, "trial": _trial} if args.trial else CHECKS)


def report(checks: Mapping[str, Callable[[], str]], *, whole: bool = WHOLE) -> int:
    """Make the checks and print a line for each; 0 when all pass, 1 otherwise. `whole`: this platform has a
    wheel of every package."""
    failed = 0
    for name, check in checks.items():
        try:
            detail = check()
            print(f"ok      {name:<12} {detail}")
        except Exception as error:
            module = name.replace("-", "_")
            if module in WITHOUT and not whole:
                print(f"off     {name:<12} {without(module)}")
                continue
            failed += 1
            print(f"MISSING {name:<12} {' '.join(str(error).split())}{_hint(error)}")
    print("everything works" if not failed else f"{failed} of {len(checks)} checks failed")
    return 1 if failed else 0


def _hint(error: Exception) -> str:
    """Advice on a missing package or shared library; what a line is made of may be another error."""
    if isinstance(error.__context__ or error, ModuleNotFoundError):
        return f" -> {INSTALL}"
    message = str(error)
    packages = {"libGL.so": "libgl1", "libEGL": "libegl1", "libX11": "libx11-6", "libudev": "libudev1"}
    packages |= {"libgomp": "libgomp1", "libusb": "libusb-1.0-0"}
    packages |= {"GLIBC": "(a newer system: glibc 2.35 or later)"}
    found = [package for part, package in packages.items() if part in message]
    return f" -> on Debian: apt install {found[0]}" if found else ""


def _gtsam() -> str:
    import gtsam

    if abs(gtsam.Pose2(1.0, 0.0, 0.0).inverse().x() + 1.0) > 1e-9:
        raise RuntimeError("gtsam gives wrong numbers with this NumPy")
    return version("gtsam")


def _open3d() -> str:
    from turtlebag.datasets.open3d_loader import open3d

    return str(open3d().__version__)


def _trial() -> str:
    from turtlebag.pipeline.setup.trial_run import trial

    return f"recorded, mapped and drove to a goal in {trial():.0f} s"


def _imports(module: str, package: str) -> Callable[[], str]:
    def check() -> str:
        importlib.import_module(module)
        return version(package)

    return check


def _pybullet() -> str:
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    pybullet.disconnect(client)
    return version("pybullet")


PACKAGES = (
    "numpy", "scipy", "numba", "pydantic", "pyyaml", "rich", "kiss-icp", "rosbags", "mcap", "zstandard",
    "lz4", "pooch", "ompl", "matplotlib", "contourpy", "pillow", "jinja2", "dask", "tornado", "distributed",
    "fsspec", "duckdb", "shtab",
)  # fmt: skip
MODULES = {
    "pyyaml": "yaml",
    "kiss-icp": "kiss_icp.pybind.kiss_icp_pybind",
    "rosbags": "rosbags.highlevel",
    "mcap": "mcap.reader",
    "lz4": "lz4.frame",
    "ompl": "ompl.geometric",
    "matplotlib": "matplotlib.figure",
    "pillow": "PIL.Image",
    "tornado": "tornado.web",
}
"""The module of a package whose name is different."""
CHECKS: dict[str, Callable[[], str]] = {
    "python": lambda: sys.version.split()[0],
    **{package: _imports(MODULES.get(package, package), package) for package in PACKAGES},
    "gtsam": _gtsam,
    "open3d": _open3d,
    "pybullet": _pybullet,
}
