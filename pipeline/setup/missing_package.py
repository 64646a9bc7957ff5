"""The message for a missing package, needed before anything of ours can be imported."""

import platform
import sys
from pathlib import Path

IN_CHECKOUT = (Path(__file__).parents[2] / "Makefile").is_file()
INSTALL = "make -B setup" if IN_CHECKOUT else "pip install turtlebag"
"""The command that installs missing packages."""
WHOLE = sys.platform == "linux" and platform.machine() == "x86_64"
"""Whether this platform has a wheel of every package."""
WITHOUT = {
    "kiss_icp": "3D maps and the odometry of KISS-ICP are off",
    "ompl": "plan and navigate need `--set plan.planner=lattice`",
    "open3d": "3D maps are off",
    "pybullet": "record, navigate and studio --world are off",
}
"""What works without a package that is not there on every platform."""


def missing_package(error: ImportError) -> str:
    """One line that names the package and what to do; an error within our own code is raised again."""
    name = (error.name or "").partition(".")[0]
    if name == "turtlebag":
        raise error
    reason = " ".join(str(error).split())
    if name in WITHOUT:
        return f"turtlebag: the package {name} is missing or does not load ({reason}): {without(name)}"
    return (
        f"turtlebag: the package {name or '?'} is missing or does not load ({reason}): "
        f"`turtlebag doctor` checks all of them, `{INSTALL}` installs them"
    )


def without(name: str) -> str:
    """What is off without a package of `WITHOUT`, and how to get it where it is to be had."""
    place = f"{platform.system()} on {platform.machine()}"
    remedy = f"`{INSTALL}` installs it" if WHOLE else f"docs/install.md says what there is for {place}"
    return f"{WITHOUT[name]}; {remedy}"
