import numpy as np

from turtlebag.datasets.runlog import Row, RunLog, write_header
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist


def sample_log() -> RunLog:
    rows = [
        Row(
            k * 33_333_333,
            T_world_base=SE2.from_xyt(k * 0.1, 1.0, 0.5),
            T_map_base=None if k < 2 else SE2.from_xyt(k * 0.1 + 0.01, 1.0, 0.5),
            T_odom_base=SE2.from_xyt(k * 0.1, 0.9, 0.4),
            command=Twist(0.2, -0.3),
            clearance_m=0.5 - k * 0.1,
            contact_visible=k == 3,
            contact_low=k == 4,
            goal_index=k - 1,
            state="follow" if k else "wait",
        )
        for k in range(5)
    ]
    return RunLog.of(rows)


def test_parts_of_a_run_log_are_one_log_again(tmp_path):
    log = sample_log()
    RunLog.joined([log, log]).save(tmp_path / "joined.csv")
    with (tmp_path / "parts.csv").open("w", newline="") as file:
        write_header(file)
        log.write_rows(file)
        log.write_rows(file)
    assert (tmp_path / "joined.csv").read_bytes() == (tmp_path / "parts.csv").read_bytes()
    assert len(RunLog.load(tmp_path / "parts.csv")) == 10
    RunLog.joined([log]).save(tmp_path / "alone.csv")
    log.save(tmp_path / "log.csv")
    assert (tmp_path / "alone.csv").read_bytes() == (tmp_path / "log.csv").read_bytes()


def test_a_run_log_comes_back_from_its_file(tmp_path):
    log = sample_log()
    log.save(tmp_path / "runlog.csv")
    poses = "0.100000,1.000000,0.500000,,,,0.100000,0.900000,0.400000"
    rest = "0.200000,-0.300000,0.400000,0,0,0,follow,navigation"
    assert (tmp_path / "runlog.csv").read_text().splitlines()[2] == f"33333333,{poses},{rest}"
    back = RunLog.load(tmp_path / "runlog.csv")
    assert back.t_ns.tolist() == log.t_ns.tolist()
    np.testing.assert_allclose(back.T_world_base.xyt, log.T_world_base.xyt, atol=1e-6)
    np.testing.assert_allclose(back.T_map_base.xyt, log.T_map_base.xyt, atol=1e-6)
    assert np.isnan(back.T_map_base.xyt[:2]).all()
    assert not np.isnan(back.T_map_base.xyt[2:]).any()
    assert back.contact_visible.tolist() == [False, False, False, True, False]
    assert back.contact_low.tolist() == [False, False, False, False, True]
    assert back.goal_index.tolist() == [-1, 0, 1, 2, 3]
    assert back.state == log.state
