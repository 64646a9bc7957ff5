"""The message for a missing package, needed before anything of ours can be imported."""

from pathlib import Path

IN_CHECKOUT = (Path(__file__).parents[2] / "Makefile").is_file()
INSTALL = "make -B setup" if IN_CHECKOUT else "pip install turtlebag"
"""The command that installs missing packages."""


def missing_package(error: ImportError) -> str:
    """One line that names the package and what to do; an error within our own code is raised again."""
    name = (error.name or "").partition(".")[0]
    if name == "turtlebag":
        raise error
    reason = " ".join(str(error).split())
    return (
        f"turtlebag: the package {name or '?'} is missing or does not load ({reason}): "
        f"`turtlebag doctor` checks all of them, `{INSTALL}` installs them"
    )
