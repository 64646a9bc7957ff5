"""What to say when a package is not there: needed before anything of ours can be imported."""


def missing_package(error: ImportError) -> str:
    """One line that names the package and says what to do; an error within our own code is raised again."""
    name = (error.name or "").partition(".")[0]
    if name == "turtlebag":
        raise error
    reason = " ".join(str(error).split())
    return (
        f"turtlebag: the package {name or '?'} is missing or does not load ({reason}): "
        "`turtlebag doctor` checks all of them, `make -B setup` reinstalls them"
    )
