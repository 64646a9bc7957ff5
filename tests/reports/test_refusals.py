"""What cannot be reported or compared: one line that says why, exit 2, and nothing is written.

Words of a command, and how its line goes on after `turtlebag: `; an ellipsis stands for anything.
"""

import pytest

from tests.helpers.refusals import require_refused
from tests.helpers.report_fakes import fake_map, fake_plan, fake_record, rehash, undrawn

MANIFESTS = ("", "[1]", "{}", '{"stage": 3}', '{"stage": "soup"}', "\udcff")
PATHS = ("", "x,y\n1,2\n", "x,y,yaw\n1,2,three\n")
STAGES = {
    "report empty": "...empty... manifest.json...",
    **{f"report manifest{k}": "...manifest.json..." for k in (0, 1, 2, 3, 5)},
    "report manifest4": "manifest4: is a soup output; a report shows record, map, localise, identify, ...",
    **{f"report map plan{k} --no-animation": "...path.csv..." for k in range(len(PATHS))},
    "report map --system-shift 1": "...there is no other system...",
    "report map record hall --system map.tum": "...belongs to one recording...",
    "report record --system map.tum": "...other systems are compared with an output of map...",
    "report --index empty": "...no finished outputs in it...",
    "compare map record": "...nothing to compare...",
    "compare map map 5.tum": "...takes outputs, or one output and files of other systems, not both",
    "compare map map --system-shift 1": "--system-shift: only for files of other systems...",
    "compare map nothing.tum": "...no such output, trajectory or map...",
}
SYSTEMS = {
    "x=nothing.tum": "...no such trajectory file...",
    "map/map.pgm": "...give the map's YAML file...",
    "a/b=map.tum": "...a system's name may contain only letters...",
    "TurtleBag=map.tum": "...give this system another...",
    "map.tum --system-shift 9000": "...share 0 instants; if its clock has another origin...",
    "map.tum --system-shift soon": "...expected a number of seconds...",
    "map.tum --system-base 1,2": "...expected three numbers...",
    "a=map.tum --system-shift b=1": "...no system named b; known: a...",
    "a=map/map.yaml --system-base 1,2,3": "...a has no trajectory...",
    "a=1.tum": "...1.tum: too few poses to compare (1; at least 3 are needed)...",
    "a=2.tum": "...2.tum: too few poses to compare (2; at least 3 are needed)...",
    "a=map": "...map: is a folder; give the file of the trajectory in it...",
    "a=5.tum --system-times map": "...map: is a folder; give the file of the times in it...",
    "a=": "...a=: names no file; write NAME=FILE...",
    "=5.tum": "...'': a system's name may contain only letters, digits, - and _",
    "truth=5.tum": "...truth: this name is taken...",
    "truth.tum": "...truth: this name is taken...",
    "TurtleBag.tum": "...TurtleBag: this name is taken...",
}
SEVERAL = {
    "x=map.tum x=map.tum": "...x already has a trajectory...",
    "a=map.tum b=map/map.yaml --system-shift 1": "...there are several systems...",
}
REFUSED = {
    **{f"{words} --out x": said for words, said in STAGES.items()},
    **{f"compare map {words}": said for words, said in SYSTEMS.items()},
    **{f"compare map {words}": said for words, said in SEVERAL.items()},
    **{f"report map --system {words} --out x": said for words, said in SYSTEMS.items()},
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder of outputs and of files of other systems, by the names that the table has for them."""
    folder = tmp_path_factory.mktemp("refused")
    (folder / "empty").mkdir()
    built = fake_map(folder / "map", fake_record(folder / "record"))
    fake_record(folder / "hall", world="hall")
    for k, text in enumerate(MANIFESTS):
        (folder / f"manifest{k}").mkdir()
        (folder / f"manifest{k}/manifest.json").write_bytes(text.encode(errors="surrogateescape"))
    for k, text in enumerate(PATHS):
        (fake_plan(folder / f"plan{k}", built) / "path.csv").write_text(text)
        rehash(folder / f"plan{k}", "path.csv")
    for count in (1, 2, 5):
        lines = (f"{second} 0 0 0 0 0 0 1\n" for second in range(count))
        (folder / f"{count}.tum").write_text("".join(lines))
    for name in ("map", "truth", "TurtleBag"):
        (folder / f"{name}.tum").write_text((built / "trajectory.tum").read_text())
    return folder


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_reported_is_one_line_that_says_why(place, monkeypatch, capsys, words):
    monkeypatch.chdir(place)
    with undrawn():
        require_refused(words, REFUSED[words], place, capsys)
