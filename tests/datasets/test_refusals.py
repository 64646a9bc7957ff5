"""Files that are not what they should be: one line that names the file and says what is wrong, as a table."""

import re

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.ply import read_ply
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.relations import load_relations
from turtlebag.datasets.runlog import COLUMNS, RunLog
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.trajectories_3d import read_trajectory_3d
from turtlebag.datasets.yaml_files import read_mapping

MAP = """\
image: map.pgm
resolution: 0.05
origin: [0, 0, 0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
PLY = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 1\n"
    b"property float x\nproperty float y\nproperty float z\nend_header\n"
)
POSE = "0 0 0 0 0 0 0 1\n"
LARGE = "image is too large (the limit is 64 million pixels"
CORNER = ": expected three numbers (x, y, yaw of the lower left corner, in metres"
MAP_VALUES = {
    "occupied_thresh": {
        "65": ": must be from 0, white, to 1, black, not 65 (0.65 in most",
        ".nan": ": must be from 0, white, to 1, black, not nan (0.65 in",
    },
    "free_thresh": {
        "2": ": must be from 0, white, to 1, black, not 2 (0.196 in most maps)",
        "25": ": must be from 0, white, to 1, black, not 25 (0.196 in most maps)",
        "-0.1": ": must be from 0, white, to 1, black, not -0.1 (0.196 in most",
        "true": ": expected a number, not true (0.196 in most maps)",
    },
    "resolution": {
        "-1": ": must be ",
        "1e300": ": must be ",
        "true": ": expected a number, not true (metres per pixel, as 0.05)",
        "1:30": ": must be a valid number (metres per pixel, as 0.05)",
        "0": ": must be greater than or equal to 0.0001 (metres per pixel",
    },
    "origin": {
        **dict.fromkeys(("[0, 0]", "[1, 2, 3, 4]", "[1, 2, true]", "[1, 2, 1:30]", "here"), CORNER),
        **dict.fromkeys(("[0, .nan, 0]", "[1, 2, .inf]"), " must be three finite numbers"),
    },
}
REFUSED = {
    "map.yaml": {
        MAP.replace("map.pgm", "gone.pgm"): "gone.pgm does not exist",
        MAP + "mode: fancy\n": "mode: ",
        **{
            re.sub(f"{key}: .*", f"{key}: {value}", MAP): f"map.yaml: {key}{said}"
            for key, values in MAP_VALUES.items()
            for value, said in values.items()
        },
        "[" * 20000: "nested too deeply",
        "- 1\n": "expected keys and values, found a list",
        "{:": "not valid YAML",
    },
    "map.pgm": {
        b"P5\n10 10\n255\nxx": "not a readable image",
        b"Pf 2 1\n-1.0\n" + bytes(8): "not a readable",
        b"GIF89a": "not a readable",
        b"II*\0" + bytes(20): "not a readable",
        b"P5 8001 8000 255\n": LARGE,
        b"P5 100000 100000 255\n": LARGE,
        b"P5 2147483647 2147483647 255\n": LARGE,
    },
    "any.yaml": {
        "a: [1\nb: 2\n": "any.yaml, line 2: not valid YAML",
        "- 1\n": "expected keys and values, found a list",
        "": "the file is empty",
        "a: 0000-00-00\n": "not valid YAML",
        "[" * 500_000: "nested too deeply",
        b"\xff\xfe\xfa": "not a text file",
        None: "no such file",
    },
    "poses.tum": {
        "1 2 3\n": "line 1: ",
        "0 a 0 0 0 0 0 1\n": "line 1: not numbers",
        "0 nan 0 0 0 0 0 1\n": "line 1: ",
        "x 0 0 0 0 0 0 1\n": "line 1: not numbers",
        "": "no poses",
    },
    "poses.txt": {
        "": "no poses",
        "# only a comment\n": "no poses",
        "hello world\n": "line 1: 2 words; a trajectory has 8 numbers",
        POSE + "0.1 0 0 0 0 0 1\n": "line 2: expected 't x y z qx qy qz qw'",
        "0 0 0 nan 0 0 0 1\n": "line 1: expected 't x y z qx qy qz qw', all finite",
        "0 0 0 0 0 0 0 0\n": "line 1: its quaternion has length 0, not 1",
        "0 1e70 0 0 0 0 0 1\n": "line 1: its position is implausibly far away",
        "x 0 0 0 0 0 0 1\n": "line 1: not numbers",
        "9e99 0 0 0 0 0 0 1\n": "line 1: 9e99 is not a time in seconds",
        "0.5,1,2,3,1,0,0,0\n": "line 1: expected a whole number of nanoseconds",
        "0,1,2\n": "line 1: expected 't [ns], x, y, z, qw",
        "1 0 0 0 0 1 0 0 0 0 1 0\n" * 2: "2 poses do not match 1 scans",
        "2 0 0 0 0 1 0 0 0 0 1 0\n": "line 1: not a pose",
        "1 0 0 0 0 1 0 0 0 0 1\n": "line 1: 11 words",
    },
    "true.relations": {
        "1 2 3 4 5 6 7\n": "line 1: expected",
        "1\n": "line 1: expected",
        "1 2 0 0 0 0 0 0\n1 2 3\n": "line 2: expected",
        "# x\n1 2 3 4 5 6 7 nan\n": "line 2: expected",
        "1 2 inf 4 5 6 7 8\n": ", all finite",
        "# only\n": "no relations",
        None: "no such relations file",
    },
    "points.ply": {
        PLY + bytes(11): "truncated",
        PLY.replace(b"ply", b"obj"): "not a binary",
        PLY.replace(b"little", b"bigger"): "not a binary",
        PLY.replace(b"float z", b"float w"): "no points x, y, z",
        b"": "not a binary",
        None: "cannot be read",
    },
    "log.clf": {
        "": "the file is empty",
        "hello\n": "",
        "# CARMEN Logfile\nODOM 0 0 0 0 0 0 1.0 h 0\n": "no FLASER or ROBOTLASER1 line in the log",
        "FLASER 3 1 2\n": "only damaged scan lines in the log",
    },
    "runlog.csv": {
        "a,b\n": "header",
        f"{','.join(COLUMNS)}\n1;2\n": "line 2",
    },
}
READERS = {
    "map.yaml": load_map,
    "map.pgm": lambda path: load_map(path.with_name("map.yaml")),
    "any.yaml": read_mapping,
    "poses.tum": load_tum,
    "poses.txt": lambda path: read_trajectory_3d(path, None, np.zeros(1, dtype=np.int64)),
    "true.relations": load_relations,
    "points.ply": read_ply,
    "log.clf": load_recording,
    "runlog.csv": RunLog.load,
}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        pytest.param(name, content, id=f"{name}: {said or k}"[:70])
        for name, rows in REFUSED.items()
        for k, (content, said) in enumerate(rows.items())
    ],
)
def test_a_file_that_is_not_what_it_should_be_is_one_line(tmp_path, recwarn, name, content):
    (tmp_path / "map.yaml").write_text(MAP)
    (tmp_path / "map.pgm").write_bytes(b"P5 1 1 255\n\0")
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError) as error:
        READERS[name](path)
    assert name in str(error.value)
    assert REFUSED[name][content] in str(error.value)
    assert "\n" not in str(error.value)
    assert not recwarn.list
