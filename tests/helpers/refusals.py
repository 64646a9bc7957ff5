"""Commands that cannot be done, as tables have them: their words, and the line that says why."""

import re
import shlex

from turtlebag.pipeline.cli.main import main


def require_refused(words, said, place, capsys):
    """Exit 2, `said` as one line on stderr with an ellipsis for anything, and nothing written in `place`."""
    before = sorted(place.rglob("*"))
    assert main(shlex.split(words)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    line = ".*".join(map(re.escape, said.split("...")))
    assert re.fullmatch(f"turtlebag: (?!turtlebag){line}\n", err), err
    assert sorted(place.rglob("*")) == before
