"""Bags cut at random bytes and with random bytes flipped: correct data and a warning, or one clear error.

python -m benchmarks.bags_damage [--count 500] [--quick] [--seed 0] [--out DIR]
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from turtlebag.datasets.bags.convert import to_ros1_bag, to_sqlite3
from turtlebag.datasets.bags.recover import recover
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording


def messages_of(path: Path) -> list[tuple[str, int, bytes]]:
    return [(m.topic.name, m.log_time_ns, m.data) for m in open_bag(path).messages()]


def judge(path: Path, whole: list[tuple[str, int, bytes]]) -> str:
    """What reading a damaged mcap came to; anything that starts with BAD breaks the promise."""
    bag = open_bag_or_none(path)
    if isinstance(bag, str):
        return bag
    got = []
    try:
        for message in bag.messages():
            got.append((message.topic.name, message.log_time_ns, message.data))
    except InputError as error:
        return one_clear_line(error)
    if got != whole[: len(got)]:
        return "BAD: wrong data"
    if bag.notes:
        return "correct data up to the damage, with a warning"
    return "BAD: damage not noticed" if len(got) < len(whole) else "BAD: change not noticed"


def open_bag_or_none(path: Path):
    try:
        return open_bag(path)
    except InputError as error:
        return one_clear_line(error)


def one_clear_line(error: InputError) -> str:
    text = str(error)
    return "one clear error" if text and "\n" not in text else "BAD: error is not one line"


def judge_recording(path: Path, ranges: np.ndarray) -> str:
    """The same for what mapping is given."""
    try:
        recording = load_recording(path)
    except InputError as error:
        return one_clear_line(error)
    if not np.array_equal(recording.ranges, ranges[: len(recording)], equal_nan=True):
        return "BAD: wrong scans"
    return "correct scans up to the damage, with a warning" if recording.notes else "BAD: no warning"


def judge_recovery(path: Path, folder: Path, whole: list[tuple[str, int, bytes]]) -> str:
    """Recovery gives a whole bag whose messages are all genuine and in their order."""
    try:
        recover(path, folder)
    except InputError as error:
        return one_clear_line(error)
    rest = iter(whole)
    if not all(any(message == other for other in rest) for message in messages_of(folder)):
        return "BAD: recovered a message that was never written"
    return "recovered"


def judge_unprotected(path: Path) -> str:
    """Formats without checksums can only promise to end in data or in one clear error."""
    try:
        count = sum(1 for _ in open_bag(path).messages())
        load_recording(path)
    except InputError as error:
        return one_clear_line(error)
    return "some data" if count else "no data"


def cuts(content: bytes, count: int, rng: np.random.Generator):
    for size in rng.integers(1, len(content), count):
        yield content[:size]


def flips(content: bytes, count: int, rng: np.random.Generator):
    for place, bits in zip(rng.integers(0, len(content), count), rng.integers(1, 256, count), strict=True):
        damaged = bytearray(content)
        damaged[place] ^= int(bits)
        yield bytes(damaged)


def campaign(bag: Path, count: int, seed: int, scratch: Path) -> dict[str, dict[str, int]]:
    """Outcomes by kind of damage and of reading."""
    whole, ranges = messages_of(bag), load_recording(bag).ranges
    content = next(bag.glob("*.mcap")).read_bytes()
    results: dict[str, dict[str, int]] = {}
    for name, damages in (("cut", cuts), ("flip", flips)):
        read, scans, saved = Counter(), Counter(), Counter()
        for index, damaged in enumerate(damages(content, count, np.random.default_rng(seed))):
            path = scratch / "damaged.mcap"
            path.write_bytes(damaged)
            read[judge(path, whole)] += 1
            scans[judge_recording(path, ranges)] += 1
            saved[judge_recovery(path, scratch / f"{name}{index}", whole)] += 1
        results |= {
            f"mcap {name}, messages": read,
            f"mcap {name}, scans": scans,
            f"mcap {name}, recover": saved,
        }
    return {name: dict(sorted(counter.items())) for name, counter in results.items()}


def other_formats(bag: Path, count: int, seed: int, scratch: Path) -> dict[str, dict[str, int]]:
    """ROS 1 and sqlite3 bags, which carry no checksums."""
    to_ros1_bag(bag, scratch / "a.bag")
    to_sqlite3(bag, scratch / "a")
    results = {}
    for file in (scratch / "a.bag", next((scratch / "a").glob("*.db3"))):
        content, whole = file.read_bytes(), messages_of(file)
        for name, damages in (("cut", cuts), ("flip", flips)):
            counter: Counter[str] = Counter()
            for damaged in damages(content, count, np.random.default_rng(seed)):
                path = scratch / f"damaged{file.suffix}"
                path.write_bytes(damaged)
                counter[judge(path, whole) if name == "cut" else judge_unprotected(path)] += 1
            results[f"{file.suffix[1:]} {name}"] = dict(sorted(counter.items()))
    return results


def main() -> int:
    sys.path.append(str(Path(__file__).parents[1] / "tests"))
    from bag_samples import write_drive

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--quick", action="store_true", help="40 of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks"))
    args = parser.parse_args()
    count = 40 if args.quick else args.count
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        write_drive(scratch / "bag", seconds=20)
        results = campaign(scratch / "bag", count, args.seed, scratch)
        results |= other_formats(scratch / "bag", count, args.seed, scratch)
    rows = [(what, outcome, n) for what, counter in results.items() for outcome, n in counter.items()]
    for what, outcome, n in rows:
        print(f"{what:24} {n:5}  {outcome}")
    args.out.mkdir(parents=True, exist_ok=True)
    with (args.out / "bags_damage.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("what", "outcome", "count"), *rows])
    return int(any(key.startswith("BAD") for counter in results.values() for key in counter))


if __name__ == "__main__":
    sys.exit(main())
