"""`turtlebag doctor`: does every package this needs import and do a little work here?"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable

from datasets.outputs import package_versions

EXAMPLE = "turtlebag doctor --trial"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "--trial",
        action="store_true",
        help="also record, map and drive for some seconds (compiles the numeric kernels, once)",
    )


def run(args: argparse.Namespace) -> int:
    """Print a line per check; 0 when all pass, 1 otherwise."""
    failed = 0
    checks = {**CHECKS, "trial": _trial} if args.trial else CHECKS
    for name, check in checks.items():
        try:
            detail = check()
            print(f"ok      {name:<12} {detail}")
        except Exception as error:
            failed += 1
            print(f"MISSING {name:<12} {' '.join(str(error).split())}{_hint(str(error))}")
    print("all good" if not failed else f"{failed} of {len(checks)} checks failed")
    return 1 if failed else 0


def _hint(message: str) -> str:
    """What to install for a missing shared library."""
    packages = {"libGL.so": "libgl1", "libEGL": "libegl1", "libX11": "libx11-6", "libudev": "libudev1"}
    packages |= {"libgomp": "libgomp1", "GLIBC": "(a newer system: glibc 2.35 or later)"}
    found = [package for part, package in packages.items() if part in message]
    return f" -> on Debian: apt install {found[0]}" if found else ""


def _python() -> str:
    return sys.version.split()[0]


def _gtsam() -> str:
    import gtsam

    if abs(gtsam.Pose2(1.0, 0.0, 0.0).inverse().x() + 1.0) > 1e-9:
        raise RuntimeError("gtsam gives wrong numbers with this NumPy")
    return package_versions()["gtsam"]


def _open3d() -> str:
    from pipeline.slam.open3d_loader import open3d

    return str(open3d().__version__)


def _trial() -> str:
    from pipeline.trial import trial

    return f"recorded, mapped and drove to a goal in {trial():.0f} s"


def _imports(module: str, package: str) -> Callable[[], str]:
    def check() -> str:
        importlib.import_module(module)
        return package_versions()[package]

    return check


def _pybullet() -> str:
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    pybullet.disconnect(client)
    return package_versions()["pybullet"]


CHECKS: dict[str, Callable[[], str]] = {
    "python": _python,
    "numba": _imports("numba", "numba"),
    "gtsam": _gtsam,
    "kiss-icp": _imports("kiss_icp.pybind.kiss_icp_pybind", "kiss-icp"),
    "open3d": _open3d,
    "rosbags": _imports("rosbags.highlevel", "rosbags"),
    "mcap": _imports("mcap.reader", "mcap"),
    "ompl": _imports("ompl.geometric", "ompl"),
    "pybullet": _pybullet,
    "matplotlib": _imports("matplotlib.figure", "matplotlib"),
}
