"""Outputs of ours, folders that are not, and what lies in them."""

import os

from turtlebag.datasets.outputs import staged_output, write_manifest


def ours(folder, **files):
    """A finished output of ours."""
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    write_manifest(folder, stage="map", command=[], inputs={}, seed=None, wall_s=0.0)
    return folder


def state(folder):
    """Everything below a folder: kinds, links and contents."""
    found = {}
    for path in sorted(folder.rglob("*")):
        content = path.read_bytes() if path.is_file() else os.readlink(path) if path.is_symlink() else ""
        found[path.relative_to(folder).as_posix()] = (path.lstat().st_mode, path.lstat().st_ino, content)
    return found


def write(out, inputs, meanwhile, *given, force=False):
    """Write an output while something else happens."""
    with staged_output(out, inputs=inputs, force=force) as partial:
        (partial / "a").write_text("a")
        meanwhile(*given)


def folder_with(name, text):
    def make(path):
        path.mkdir()
        (path / name).write_text(text)

    return make
