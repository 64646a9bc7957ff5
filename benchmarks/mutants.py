"""Small mistakes made in the code one at a time: how many do the tests of its subject notice?

python -m benchmarks.mutants [--seed 1] [--count 100] [--together S] [--survivors] [--ref COMMIT] [--out DIR]

Which tests run which function is measured once (minutes), and anew for test files that changed (for all of
them when OUT/tests.json is deleted). Every mutant is tried in a copy of the tree on the tests that run its
function, the quickest first. A row is written as soon as it is known, and the same command goes on from
there; `--survivors` tries only those again that nothing noticed. Mutants that change nothing that matters
are listed in mutants_equivalent.yaml with the reason, and do not count. Needs Python 3.11.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections import Counter
from pathlib import Path
from typing import Any

import yaml

from benchmarks.intervals import wilson
from benchmarks.mutants_draw import FOLDERS, Mutant, draw
from benchmarks.mutants_run import Tree
from benchmarks.mutants_tests import TOGETHER_S, Recorder, chosen, folder_of, imported, load, subject_files

ROOT = Path(__file__).parents[1]
EQUIVALENT = Path(__file__).with_name("mutants_equivalent.yaml")
CAUGHT = ("failed", "timeout", "crashed")
MEASURING_S = 900.0


def measured(tree: Tree, home: Path) -> dict[str, dict[str, Any]]:
    """Per test its seconds, functions and subjects; measures what is not known yet."""
    kept = home / "tests.json"
    table = load(kept)
    files = {name for folder in FOLDERS for name in subject_files(tree.path, folder)}
    table = {test: row for test, row in table.items() if row["digest"] == _digest(tree.path / _file(test))}
    for name in sorted(files - {_file(test) for test in table}):
        print(f"measuring {name}", flush=True)
        recorder, part = Recorder(tree.path), home / "part.json"
        outcome = tree.run(
            [name],
            cpu_s=MEASURING_S,
            plugin=recorder,
            after=lambda rows=recorder.rows, part=part: part.write_text(json.dumps(rows)),
        )
        if outcome.verdict == "failed":
            print(f"  {outcome.by} fails without any mutant and is not asked")
        for test, row in load(part).items():
            if "functions" in row:
                table[test] = row | {"digest": _digest(tree.path / name)}
        part.unlink(missing_ok=True)
        kept.write_text(json.dumps(table))
    subjects = {folder: set(subject_files(tree.path, folder)) for folder in FOLDERS}
    imports = {name: imported(tree.path / name) for name in files}
    for test, row in table.items():
        row["imports"] = imports[_file(test)]
        row["subjects"] = [folder for folder in FOLDERS if _file(test) in subjects[folder]]
    return table


def _file(test: str) -> str:
    return test.split("::", 1)[0]


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.exists() else ""


def tried(tree: Tree, table: dict[str, dict[str, Any]], mutant: Mutant, together_s: float) -> dict[str, Any]:
    """The row of one mutant."""
    tests = chosen(table, mutant.path, mutant.function, together_s)
    usual = sum(table[test]["seconds"] for test in tests)
    row = {"key": mutant.key, "kind": mutant.kind, "kernel": mutant.kernel, "tests": len(tests)}
    if not tests:
        return row | {"verdict": "survived", "by": "no test runs it", "seconds": 0.0}
    outcome = tree.judge(mutant, tests, usual)
    return row | {"verdict": outcome.verdict, "by": outcome.by, "seconds": round(outcome.seconds, 1)}


def report(rows: list[dict[str, Any]], equivalent: dict[str, str]) -> str:
    """The score with its interval, by folder and kind, and what survived."""
    counted = [row for row in rows if row["key"] not in equivalent or row["verdict"] in CAUGHT]
    caught = sum(row["verdict"] in CAUGHT for row in counted)
    low, high = wilson(caught, len(counted))
    verdicts = Counter(row["verdict"] for row in counted)
    share = caught / max(1, len(counted))
    lines = [
        f"{caught} of {len(counted)} caught: {share:.0%} (95 % interval {low:.0%} to {high:.0%}); "
        f"{', '.join(f'{n} {name}' for name, n in sorted(verdicts.items()))}; "
        f"{len(rows) - len(counted)} of {len(rows)} drawn change nothing that matters",
        "",
        f"{'of':24}  caught",
    ]
    groups = {folder: [row for row in counted if folder_of(row["key"]) == folder] for folder in FOLDERS}
    groups["numba kernels"] = [row for row in counted if row["kernel"]]
    groups["other functions"] = [row for row in counted if not row["kernel"]]
    groups |= {
        kind: [row for row in counted if row["kind"] == kind] for kind in sorted({r["kind"] for r in rows})
    }
    for name, group in groups.items():
        lines.append(f"{name:24}  {sum(row['verdict'] in CAUGHT for row in group)} of {len(group)}")
    survived = [row for row in counted if row["verdict"] not in CAUGHT]
    lines += ["", *(f"survived {row['tests']:3} tests: {row['key']}" for row in survived)]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--survivors", action="store_true", help="try those again that nothing noticed")
    parser.add_argument("--together", type=float, default=TOGETHER_S, help="seconds of tests for a mutant")
    parser.add_argument("--ref", default="", help="a commit, for the tree as it was; default: as it is")
    parser.add_argument("--out", type=Path, default=ROOT / "data/benchmarks/mutants")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / f"seed-{args.seed}.jsonl"
    equivalent = yaml.safe_load(EQUIVALENT.read_text()) or {}
    rows = (
        {row["key"]: row for row in map(json.loads, path.read_text().splitlines())} if path.exists() else {}
    )
    tree = Tree(ROOT, args.out.resolve(), args.ref)
    mutants = draw(tree.path, args.seed, args.count)
    again = {key for key, row in rows.items() if row["verdict"] == "survived"} if args.survivors else set()
    todo = [m for m in mutants if m.key not in equivalent and (m.key not in rows or m.key in again)]
    table = measured(tree, args.out) if todo else {}
    for mutant in todo:
        rows[mutant.key] = tried(tree, table, mutant, args.together)
        with path.open("a") as out:
            out.write(json.dumps(rows[mutant.key]) + "\n")
        print(
            f"{rows[mutant.key]['verdict']:9} {rows[mutant.key]['seconds']:6.1f} s  {mutant.key}", flush=True
        )
    skipped = {"kind": "", "kernel": False, "tests": 0, "verdict": "equivalent", "by": "", "seconds": 0.0}
    final = [rows.get(m.key, {"key": m.key, **skipped}) for m in mutants]
    text = report(final, equivalent)
    (args.out / f"seed-{args.seed}.txt").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
