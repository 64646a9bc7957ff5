"""Relations, PLY and YAML files: what is read, and one line for what is wrong."""

import struct

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.ply import read_ply, write_ply
from turtlebag.datasets.relations import load_relations
from turtlebag.datasets.yaml_files import checked, find_named, known_names, parsed

S = 10**9


def test_relations_are_read_line_by_line(tmp_path):
    path = tmp_path / "a.relations"
    path.write_text("# comment\n\n1.5 2.25 1 2 9 9 9 0.5\n3 4 -1 0 0 0 0 -0.5\n")
    found = load_relations(path)
    assert (found.stamps_a_ns.tolist(), found.stamps_b_ns.tolist()) == (
        [1_500_000_000, 3 * S],
        [2_250_000_000, 4 * S],
    )
    np.testing.assert_allclose(found.T_a_b.xyt, [[1, 2, 0.5], [-1, 0, -0.5]])
    assert len(found) == 2


def test_ply_files_hold_points_and_colours(tmp_path):
    path, rng = tmp_path / "a.ply", np.random.default_rng(1)
    points = rng.normal(size=(5, 3))
    colours = np.array([[0.0, 0.5, 1.0], [1.0, 0.0, 0.0], [0.1, 0.2, 0.3], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    write_ply(path, points, colours)
    np.testing.assert_array_equal(read_ply(path), points)
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    assert head.startswith(b"ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty double x\n")
    table = np.frombuffer(body, np.dtype([("p", "<f8", 3), ("c", "u1", 3)]))
    np.testing.assert_array_equal(table["c"], np.floor(colours * 255 + 0.5))
    other = b"ply\nformat binary_little_endian 1.0\nelement vertex 2\n"
    other += b"property short z\nproperty float x\nproperty double y\nend_header\n"
    path.write_bytes(other + struct.pack("<hfdhfd", 3, 1.0, 2.0, 6, 4.0, 5.0))
    np.testing.assert_array_equal(read_ply(path), [[1, 2, 3], [4, 5, 6]])


class Small(BaseModel):
    model_config = ConfigDict(extra="forbid")
    size: int = 3


@pytest.mark.slow
def test_yaml_is_read_with_one_line_for_what_is_wrong(tmp_path):
    path = tmp_path / "a.yaml"
    assert parsed("a: 1", where="x") == {"a": 1}
    assert checked(Small, {"size": 5}, where="x").size == 5
    for data, says in (
        ({"sise": 1}, "x: sise: unknown key"),
        ({"size": "a"}, "x: size: must be"),
        ([], "x: top level: "),
    ):
        with pytest.raises(InputError, match=says):
            checked(Small, data, where="x")
    path.write_text("size: 1")
    (tmp_path / "b.yaml").touch()
    assert find_named("a", tmp_path, "world") == path
    assert find_named(str(path), tmp_path / "x", "world") == path
    assert known_names(tmp_path) == ["a", "b"]
    with pytest.raises(InputError, match=r"c.*a, b"):
        find_named("c", tmp_path, "world")
    for missing in ("c.yaml", "c.yml", "./c"):
        with pytest.raises(InputError, match="no such world file"):
            find_named(missing, tmp_path, "world")


def test_numbers_to_the_base_of_60_are_texts():
    found = parsed("[1:30, 1:30.5, -2:00, 90, 0.5, 12:x]", where="a")
    assert found == ["1:30", "1:30.5", "-2:00", 90, 0.5, "12:x"]
