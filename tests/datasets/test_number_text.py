"""Numbers in text mean in every file and option what they mean to other programs."""

import argparse

import numpy as np
import pytest

from tests.helpers.carmen_lines import flaser, write
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal, decimals, whole
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.trajectories import load_tum, stamp_from_text
from turtlebag.pipeline.stages.command_line import read as read_words
from turtlebag.pipeline.stages.parser import count, positive
from turtlebag.reports.g2o import read_g2o
from turtlebag.sim.sdf import pose_matrix
from turtlebag.sim.worlds import load_world

NO_NUMBERS = ["2_3", "1_0.5", "٢", "1e1_0", "", "x", "0x10"]


def test_what_every_program_reads_as_a_number_is_one():
    assert [decimal(text) for text in ("2.5", "-3", "+1e-3", ".5")] == [2.5, -3.0, 1e-3, 0.5]
    assert [whole(text) for text in ("7", "-7", "007")] == [7, -7, 7]
    assert decimals(["1", "2.5"]) == [1.0, 2.5]


@pytest.mark.parametrize("text", NO_NUMBERS)
def test_what_python_alone_reads_as_a_number_is_none(text):
    for read in (decimal, whole, lambda word: decimals(["1", word])):
        with pytest.raises(ValueError):
            read(text)


@pytest.mark.parametrize("text", ["1_0", "1_0.5", "1.-5", "1.5_0", "٢.5"])
def test_a_stamp_is_a_plain_number(text):
    with pytest.raises(ValueError):
        stamp_from_text(text)


def test_a_line_of_a_carmen_log_with_no_plain_number_is_damaged(tmp_path):
    good = flaser(np.ones(180))
    bad = flaser(np.full(180, 2.3)).replace(" 2.30", " 2_3.0", 1)
    found = load_recording(write(tmp_path, good + bad + good))
    assert len(found) == 2
    assert "1 damaged line skipped, the first is line 2" in found.notes


def test_options_and_other_files_take_plain_numbers_only(tmp_path):
    for read in (positive, count):
        with pytest.raises(argparse.ArgumentTypeError, match="not 2_3"):
            read("2_3")
    with pytest.raises(InputError, match="--start 1_0,0,0: expected X,Y,YAW"):
        read_words(["record", "--world", "empty", "--start", "1_0,0,0"])
    with pytest.raises(InputError, match="cells=1_0: must be a whole number"):
        load_world("maze:7,cells=1_0")
    with pytest.raises(ValueError):
        pose_matrix("1_0 0 0 0 0 0")
    tum, graph = tmp_path / "a.tum", tmp_path / "a.g2o"
    tum.write_text("0 1_0 0 0 0 0 0 1\n")
    graph.write_text("VERTEX_SE2 0 1_0 0 0\n")
    with pytest.raises(InputError, match="line 1: not numbers"):
        load_tum(tum)
    with pytest.raises(InputError, match="line 1: not a VERTEX_SE2 line"):
        read_g2o(graph)
