"""Tables that grow case by case: what was measured before a benchmark was stopped is not measured again."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

Row = dict[str, Any]


class Cases:
    """Rows kept as one JSON file a case below `folder`; `again` measures all anew."""

    def __init__(self, folder: Path, *, again: bool = False) -> None:
        self._folder, self._again = folder, again
        folder.mkdir(parents=True, exist_ok=True)

    def row(self, table: str, case: str, measure: Callable[[], Row]) -> Row:
        """The row of a case: read when it is there, measured and kept when not."""
        file = self._folder / f"{table}-{re.sub('[^A-Za-z0-9.-]+', '_', case)}.json"
        if file.exists() and not self._again:
            return dict(json.loads(file.read_text()))
        row = measure()
        file.write_text(json.dumps(row, indent=1) + "\n")
        print("  ", row, flush=True)
        return row


def write(out: Path, name: str, rows: list[Row]) -> None:
    """A CSV file, and the same as a markdown table on the terminal and in a file."""
    if not rows:
        return
    columns = list(rows[0])
    with (out / f"{name}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
    lines = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    lines += ["| " + " | ".join(str(row.get(column, "")) for column in columns) + " |" for row in rows]
    text = "\n".join(lines) + "\n"
    (out / f"{name}.md").write_text(text)
    print(f"\n{name}\n{text}", flush=True)
