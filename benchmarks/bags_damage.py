"""Bags cut at random bytes and with random bytes flipped: correct data and a warning, or one clear error.

python -m benchmarks.bags_damage [--count 500] [--quick] [--seed 0] [--out DIR]
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.runner import options, write
from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.bags.convert import to_ros1_bag, to_sqlite3
from turtlebag.datasets.bags.recover import recover
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording

Messages = list[tuple[str, int, bytes]]


def messages_of(path: Path) -> Messages:
    return [(m.topic.name, m.log_time_ns, m.data) for m in open_bag(path).messages()]


def judged(judge: Callable[[], str]) -> str:
    """What reading came to; anything that starts with BAD breaks the promise."""
    try:
        return judge()
    except InputError as error:
        return "one clear error" if str(error) and "\n" not in str(error) else "BAD: error is not one line"


def read(path: Path, whole: Messages) -> str:
    """What reading a damaged mcap came to."""
    bag = open_bag(path)
    got = [(message.topic.name, message.log_time_ns, message.data) for message in bag.messages()]
    if got != whole[: len(got)]:
        return "BAD: wrong data"
    if bag.notes:
        return "correct data up to the damage, with a warning"
    return "BAD: damage not noticed" if len(got) < len(whole) else "BAD: change not noticed"


def scans(path: Path, ranges: np.ndarray) -> str:
    """The same for what mapping is given."""
    recording = load_recording(path)
    if not np.array_equal(recording.ranges, ranges[: len(recording)], equal_nan=True):
        return "BAD: wrong scans"
    return "correct scans up to the damage, with a warning" if recording.notes else "BAD: no warning"


def recovered(path: Path, folder: Path, whole: Messages) -> str:
    """Recovery gives a whole bag whose messages are all genuine and in their order."""
    recover(path, folder)
    rest = iter(whole)
    if not all(any(message == other for other in rest) for message in messages_of(folder)):
        return "BAD: recovered a message that was never written"
    return "recovered"


def unprotected(path: Path) -> str:
    """Formats without checksums can only promise to end in data or in one clear error."""
    count = sum(1 for _ in open_bag(path).messages())
    load_recording(path)
    return "some data" if count else "no data"


def cuts(content: bytes, count: int, rng: np.random.Generator):
    for size in rng.integers(1, len(content), count):
        yield content[:size]


def flips(content: bytes, count: int, rng: np.random.Generator):
    for place, bits in zip(rng.integers(0, len(content), count), rng.integers(1, 256, count), strict=True):
        damaged = bytearray(content)
        damaged[place] ^= int(bits)
        yield bytes(damaged)


def campaign(bag: Path, count: int, seed: int, scratch: Path) -> Iterator[tuple[str, str]]:
    """Kind of file, damage and reading, and its outcome; ROS 1 and sqlite3 bags carry no checksums."""
    ranges = load_recording(bag).ranges
    to_ros1_bag(bag, scratch / "a.bag")
    to_sqlite3(bag, scratch / "a")
    for file in (next(bag.glob("*.mcap")), scratch / "a.bag", next((scratch / "a").glob("*.db3"))):
        content, whole = file.read_bytes(), messages_of(file)
        kind, path = file.suffix[1:], scratch / f"damaged{file.suffix}"
        for name, damages in (("cut", cuts), ("flip", flips)):
            for k, damaged in enumerate(damages(content, count, np.random.default_rng(seed))):
                path.write_bytes(damaged)
                if kind == "mcap":
                    saved = scratch / f"{name}{k}"
                    yield f"mcap {name}, messages", judged(partial(read, path, whole))
                    yield f"mcap {name}, scans", judged(partial(scans, path, ranges))
                    yield f"mcap {name}, recover", judged(partial(recovered, path, saved, whole))
                elif name == "cut":
                    yield f"{kind} cut", judged(partial(read, path, whole))
                else:
                    yield f"{kind} flip", judged(partial(unprotected, path))


def main() -> int:
    args = options(__doc__, quick="40 of each kind", count=500, seed=0).parse_args()
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        write_drive(scratch / "bag", seconds=20)
        counts = Counter(campaign(scratch / "bag", 40 if args.quick else args.count, args.seed, scratch))
    rows = [{"what": what, "outcome": outcome, "count": n} for (what, outcome), n in sorted(counts.items())]
    write(args.out, "bags_damage", rows)
    return int(any(outcome.startswith("BAD") for _, outcome in counts))


if __name__ == "__main__":
    sys.exit(main())
