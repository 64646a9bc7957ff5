"""What the campaign's rows come to, and what was asked."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.slam_detector import BAD_M, detection
from benchmarks.slam_rows import Row

LOGS_M = {
    "intel": 0.0126,
    "fr079": 0.0305,
    "mit-csail": 0.0268,
    "aces": 0.035,
    "infinite-corridor": 0.6,
    "belgioioso": 0.2,
    "fhw": 0.16,
    "acapulco": 0.16,
}
LOGS_DEG = {"aces": 0.35}
RATIOS = {"noise3": 2.0, "third": 2.0, "reverse": 1.2}
RATIO = 1.5
DRIVES_SHARE = 290 / 300
DOUBTED_SHARE = 0.02


def target(what: str, asked: str, found: str, met: bool) -> Row:
    """A line of the summary."""
    return {"what": what, "asked": asked, "found": found, "met": "yes" if met else "NO"}


def logs(rows: Sequence[Row]) -> list[Row]:
    """Each log against what was asked of it."""
    found = []
    for row in rows:
        if (metres := LOGS_M.get(row["case"])) is None:
            continue
        degrees = LOGS_DEG.get(row["case"])
        asked = f"{metres} m" + (f" / {degrees} deg" if degrees else "")
        m, deg = row.get("m", np.inf), row.get("deg", np.inf)
        # to the digit the target is given in
        met = round(m, 4) <= metres and (degrees is None or deg <= degrees)
        found.append(target(row["case"], asked, row.get("error") or f"{m:.4f} m / {deg:.3f} deg", met))
    return found


def disturbed(rows: Sequence[Row]) -> list[Row]:
    """Of each mode the worst ratio to the undisturbed log; a log without a map misses it."""
    found = []
    for mode in dict.fromkeys(row["mode"] for row in rows):
        part, limit = [row for row in rows if row["mode"] == mode], RATIOS.get(mode, RATIO)
        failed = [row["log"] for row in part if "error" in row]
        scored = {row["log"]: row["ratio"] for row in part if "ratio" in row}
        by_map = {row["log"]: row["m"] for row in part if "ratio" not in row and "m" in row}
        worst = max(scored.values(), default=0.0)
        texts = [f"{log} {ratio:.2f} x" for log, ratio in scored.items()]
        texts += [f"{log} {m:.4f} m from the undisturbed map" for log, m in by_map.items()]
        texts += [f"{log} without a map" for log in failed]
        found.append(target(mode, f"{limit} x", ", ".join(texts), worst <= limit and not failed))
    return found


def share(rows: Sequence[Row], limit: float, key: str = "worst_m") -> int:
    """How many are nowhere farther off than a limit [m]."""
    return sum(row[key] <= limit for row in rows)


def spread(rows: Sequence[Row]) -> Row:
    """Figures of many maps with exact truth; m after a rigid fit."""
    done = [row for row in rows if "error" not in row]
    if not done:
        return {"maps": 0, "errors": len(rows)}
    far = [row for row in done if row["worst_m"] > BAD_M]
    return {
        "maps": len(done),
        "errors": len(rows) - len(done),
        "median m": float(np.median([row["m"] for row in done])),
        "median worst": float(np.median([row["worst_m"] for row in done])),
        "worst": max(row["worst_m"] for row in done),
        "under 5 cm": share(done, 0.05),
        "under 10 cm": share(done, 0.1),
        "under 10 cm, anchored": share(done, 0.1, "anchored_worst_m"),
        f"beyond {BAD_M} m": len(far),
        "of these good": sum(row["verdict"] == "good" for row in far),
        "others doubtful": sum(row["verdict"] != "good" for row in done if row not in far),
        "CPU s": float(np.sum([row["cpu_s"] for row in done])),
    }


def by(*keys: str) -> Callable[[list[Row]], list[Row]]:
    """A table of `spread`: all rows, and those of each value of some columns."""

    def table(rows: list[Row]) -> list[Row]:
        parts = {"all": rows}
        for key in keys:
            for value in dict.fromkeys(row[key].partition(":")[0] for row in rows):
                parts[value] = [row for row in rows if row[key].partition(":")[0] == value]
        return [{"of": name, **spread(part)} for name, part in parts.items()]

    return table


def drives(rows: Sequence[Row]) -> list[Row]:
    """Few drives beyond 10 cm, and none far off that is called good."""
    all_of, enough = spread(rows), DRIVES_SHARE * len(rows)
    good = all_of.get("of these good", 0)
    found = [target(f'beyond {BAD_M} m and called "good"', "0", str(good), good == 0)]
    for what, key in (("rigid fit", "under 10 cm"), ("first pose", "under 10 cm, anchored")):
        count = all_of.get(key, 0)
        text = f"{count} of {len(rows)}"
        found.append(target(f"worst scan under 10 cm, {what}", "290 of 300", text, count >= enough))
    return found


def fast50(rows: Sequence[Row]) -> list[Row]:
    """All fifty seeds under 2 cm, with either set of sensors."""
    found = []
    for sensors in dict.fromkeys(row["sensors"] for row in rows):
        part = [row for row in rows if row["sensors"] == sensors]
        for what, key in (
            ("rigid fit", "m"),
            ("scale fitted, too", "scaled_m"),
            ("first pose", "anchored_m"),
        ):
            count = sum(row.get(key, np.inf) < 0.02 for row in part)
            text = f"{count} of {len(part)}"
            found.append(target(f"{sensors}: RMSE under 2 cm, {what}", "all", text, count == len(part)))
    return found


def detector(rows: Sequence[Row]) -> list[Row]:
    """No bad map of the half kept for scoring called good, few others doubted."""
    found = []
    for line in detection(rows):
        if line["maps"] in ("all", "build", "score"):
            _, _, good, far, doubted = line.values()
            wrong, (few, of) = int(good.split()[0]), (int(doubted.split()[k]) for k in (0, 2))
            asked = f"at most {100 * DOUBTED_SHARE:.0f} %"
            found += [
                target(
                    f'{line["maps"]}: bad and called "good"',
                    "0",
                    f"{good}; beyond {BAD_M} m {far}",
                    wrong == 0,
                ),
                target(f'{line["maps"]}: right and "doubtful"', asked, doubted, few <= DOUBTED_SHARE * of),
            ]
    return found


def ablation(rows: Sequence[Row]) -> list[Row]:
    """Wheels never make a map worse than no wheels."""
    found = {(row["log"], row["variant"]): row.get("m", np.inf) for row in rows}
    return [
        target(
            f"{log}: with wheels and without",
            "no worse",
            f"{found[log, 'everything']:.4f}, {m:.4f}",
            round(found[log, "everything"], 3) <= round(m, 3),
        )
        for (log, variant), m in found.items()
        if variant == "lidar only" and (log, "everything") in found
    ]
