"""What cannot be done is one line on stderr that says why, exit 2, and nothing is written: the table of it.

Words of a command, and how its line goes on after `turtlebag: `; an ellipsis stands for anything.
"""

import pytest

from tests.helpers.bag_samples import write_drive
from tests.helpers.fuzz_cases import carmen_log
from tests.helpers.refusals import require_refused

RECORD = "record --world empty --out x"
MANY = "9" * 5000
USAGE = {
    "": "...",
    "navigate": "...",
    "bag": "...",
    "bag info": "...",
    "mpa": "...",
    "map --ot x": "...",
    "map '' --out x": "empty argument after map; is a shell variable unset?",
    "map log --name '' --out x": "empty argument after --name; ...",
    "completion cmd": "...",
    "--foo map": "unrecognized arguments: --foo (see turtlebag --help)",
    "bag --foo=1 info": "bag: unrecognized arguments: --foo=1 (see turtlebag bag --help)",
    f"{RECORD} --sed 1": "record: unrecognized arguments: --sed; did you mean --seed? (see ...)",
    f"{RECORD} --sed=1": "record: unrecognized arguments: --sed=1; did you mean --seed? (see ...)",
    f"{RECORD} --qqq": "record: unrecognized arguments: --qqq (see turtlebag record --help)",
    "record --wor empty --out x": "record: unrecognized arguments: --wor; did you mean --world? (see ...)",
}
NUMBERS = {
    f"{command} {value}": f"...argument {command.split()[-1]}: must be {what}, not {value}..."
    for commands, values, what in (
        (("bag play BAG --rate", "teleop --speed"), ("0", "-1", "inf", "nan", "fast"), "a positive number"),
        (("record --seed",), ("-1", "1.5", "many", MANY), "a whole number, 0 or more"),
        (("navigate --laps", "sweep --workers"), ("-1", "1.5", "many", MANY), "a whole number, 1 or more"),
    )
    for command in commands
    for value in values
}
NAMES = {
    f"map log --name {name} --out x": f"--name {name}: ..." for name in ("a/b", "../x", "config", "map", ".x")
}
BAGS = {
    "bag info nothing": "nothing: no such file...",
    "bag recover empty.mcap --out x": "...",
    "bag convert drive --out a.bag.gz": "...a.bag.gz: bags are written unpacked; leave out .gz",
    "bag convert drive --exclude /tf_statik --out x": "--exclude /tf_statik: no such topic; ...",
}
UNUSED = {
    "bag convert drive --out x.bag": "--out x.bag: ROS 1 bags are read but not written; ...",
    "bag convert drive.clf --exclude /odom --out x": "--exclude...",
    "report . --index --paper --out x": "--paper...",
    "report . --index --no-animation --out x": "--no-animation...",
    "report . --index --system-shift 1 --out x": "--system-shift...",
    "sweep . --query 'select 1' --out x": "--out...",
    "sweep . --query 'select 1' --workers 2": "--workers...",
}
AVOID = "navigate --world empty --task avoid"
FORMER = {
    "ablate data/records/world --replace odometry --out x": (
        "ablate is gone; give map or navigate a part that knows the truth, e.g. "
        "--set front_end=turtlebag.testing:TrueFrontEnd"
    ),
    "blame data/records/world --out x": "blame is gone; give map or navigate a part that knows ...",
    "teleop --world empty --view=1 --out x": "teleop: --view is gone; turtlebag studio shows the scan ...",
    f"{AVOID} --takeover keyboard --out x": (
        "navigate: --takeover is now called --teleop-override (see turtlebag navigate --help)"
    ),
    f"{AVOID} --takeover=mine.yaml --out x": "navigate: --takeover is now called --teleop-override (see ...)",
    "report data/maps/a --rival other.tum --out x": "report: --rival is now called --system (see ...)",
    "compare data/maps/a other.tum --rival-shift 1": "compare: --rival-shift is now called ...",
}
REFUSED = FORMER | USAGE | NUMBERS | NAMES | BAGS | UNUSED


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder of good inputs, by the names that the table has for them."""
    folder = tmp_path_factory.mktemp("refused")
    write_drive(folder / "drive", seconds=1)
    (folder / "log").mkdir()
    (folder / "drive.clf").write_text(carmen_log())
    (folder / "empty.mcap").write_bytes(b"\x89MCAP0\r\n")
    return folder


@pytest.mark.parametrize("words", REFUSED, ids=lambda words: words[:60])
def test_what_cannot_be_done_is_one_line_that_says_why(place, monkeypatch, capsys, words):
    monkeypatch.chdir(place)
    require_refused(words, REFUSED[words], place, capsys)
