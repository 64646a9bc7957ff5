"""The table of platforms in docs/install.md is what the index has wheels for. Nothing is installed."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from turtlebag.pipeline.setup.install import settings_of_pip

ROOT = Path(__file__).parents[2]
ASKED = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
WITHOUT_MARKERS = {one.name: f"{one.name}{one.specifier}" for one in map(Requirement, ASKED)}
UV = Path(sys.executable).with_name("uv")
ROWS = {
    "bags": ("gtsam", "numba", "rosbags", "mcap", "duckdb", "tornado", "libusb-package"),
    "Open3D": ("open3d", "kiss-icp"),
    "OMPL": ("ompl",),
    "Bullet": ("pybullet",),
}
"""What the rows of the table need, by how they begin."""
SHOWN = ("gtsam", "numba", "open3d", "open3d-cpu", "kiss-icp", "ompl", "pybullet")
COLUMNS = {
    "Linux x86-64": "x86_64-manylinux_2_35",
    "Linux aarch64": "aarch64-manylinux_2_35",
    "macOS 14 or later, arm64": "aarch64-apple-darwin",
    "macOS 14 or later, Intel": "x86_64-apple-darwin",
}
pytestmark = pytest.mark.skipif(
    "TURTLEBAG_PLATFORMS" not in os.environ, reason="asks the package index: `make platforms` does"
)


def table():
    """The cells of the table of platforms, by row and column."""
    text = (ROOT / "docs/install.md").read_text().partition("## Platforms")[2]
    head, _, *rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in re.findall(r"^\|.*\|$", text, re.M)
    ]
    return {row[0].split(",")[0].split(":")[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}


def wheels(requirements, platform, macos="14.0"):
    """Versions by package of what pip would install there, wheels only; None where something has none."""
    words = ["pip", "compile", "-", "-q", "--no-header", "--no-annotate", "--only-binary", ":all:"]
    done = subprocess.run(
        [UV, *words, "--python-version", "3.11", "--python-platform", platform],
        input="\n".join(requirements),
        cwd=ROOT,
        env={**os.environ, **settings_of_pip(), "MACOSX_DEPLOYMENT_TARGET": macos},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    if done.returncode:
        assert "No solution found" in done.stderr, done.stderr
        return None
    return dict(re.findall(r"^([\w.-]+)==(\S+)", done.stdout, re.M))


def found(package, versions):
    """Open3D has a smaller wheel where it is built for the CPU alone."""
    return package in versions or f"{package}-cpu" in versions


@pytest.mark.parametrize("column", COLUMNS)
def test_each_cell_of_the_table_of_platforms_is_what_the_index_has(column):
    platform, cells = COLUMNS[column], {row: columns[column] for row, columns in table().items()}
    assert set(cells) == set(ROWS)
    versions = wheels(ASKED, platform)
    assert versions, f"turtlebag cannot be installed on {column}"
    print(f"\n{column}: {', '.join(f'{name} {versions[name]}' for name in SHOWN if name in versions)}")
    for row, packages in ROWS.items():
        alone = [WITHOUT_MARKERS[name] for name in packages]
        assert all(found(name, versions) for name in packages) == (cells[row] == "yes"), row
        if cells[row] != "yes":
            assert wheels(alone, platform) is None, f"{row}: there are wheels now"
        if "macOS 15" in cells[row]:
            assert wheels(alone, platform, "15.0"), row
