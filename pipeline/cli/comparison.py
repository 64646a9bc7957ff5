"""What `turtlebag compare` prints."""

from __future__ import annotations

from turtlebag.datasets.plurals import counted
from turtlebag.pipeline.terminal.messages import print_table, say
from turtlebag.reports.compare import Comparison
from turtlebag.reports.system_comparison import SystemComparison


def print_comparison(found: Comparison | SystemComparison) -> None:
    """The differences as a table."""
    if isinstance(found, SystemComparison):
        _print_systems(found)
    else:
        _print_runs(found)


def _print_systems(found: SystemComparison) -> None:
    for name, note in found.notes:
        say(f"{name}: {note}")
    texts = [(row.spec.label, *row.texts, row.spec.evo) for row in found.rows]
    print_table([("", *found.names, "evo"), *texts], left=(0, -1))
    say(found.sentence)


def _print_runs(found: Comparison) -> None:
    for side in found.sides:
        say(side.title)
    for key, texts in found.settings:
        say(f"{key}: {' | '.join(texts)}")
    heads, lines = ["", "A"], [[row.spec.label, row.summaries[0].text] for row in found.rows]
    for k, side in enumerate(found.sides[1:]):
        heads += [side.letter, f"{side.letter} - A", ""]
        for line, row in zip(lines, found.rows, strict=True):
            one = row.differences[k]
            line += [row.summaries[k + 1].text, one.text, one.verdict]
    print_table([tuple(heads), *map(tuple, lines)] if lines else [])
    for sentence in found.sentences:
        say(sentence)
    if found.pair is not None:
        same, other = len(found.pair.same_bytes), len(found.pair.changed)
        say(f"{counted(same, 'file')} identical, {other} different")
