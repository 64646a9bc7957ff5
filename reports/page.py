"""The page: one HTML file that needs nothing beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from turtlebag.datasets.plurals import counted
from turtlebag.reports.content import Chapter
from turtlebag.reports.figures import style
from turtlebag.reports.glossary import WORDS, explained
from turtlebag.reports.kinds import KINDS
from turtlebag.reports.metric_specs import GOAL_NUMBERS, SPECS
from turtlebag.reports.metrics.navigation import goal_counts
from turtlebag.reports.numbers import lookup, shown
from turtlebag.reports.verdicts import BAD, GOOD, GOOD_WALLS, NEUTRAL, collision_count, overall_mood

# Figure colours that follow the page's theme instead of staying what they are in the files.
THEMED = {
    style.INK: "var(--ink)",
    style.MUTED: "var(--muted)",
    style.RULE: "var(--rule)",
    style.PAPER: "var(--paper)",
}


@dataclass(frozen=True)
class Tile:
    """One of the figures that matter."""

    label: str
    value: str
    note: str
    meaning: str
    mood: str = NEUTRAL
    key: str = ""
    number: float | None = None


def render(chapters: Sequence[Chapter], steps: Sequence[object], packages: Sequence[tuple[str, str]]) -> str:
    """The report's page as HTML text; `steps` and `packages` say how to make its numbers again."""
    mood, headline = overall(chapters)
    return fill(
        "report.html.j2",
        chapters=chapters,
        mood=mood,
        headline=headline,
        tiles=tiles(chapters),
        steps=steps,
        packages=packages,
        words=WORDS,
        goal_numbers=GOAL_NUMBERS,
        planner_numbers=SPECS["plan"],
        good_walls=GOOD_WALLS,
    )


def fill(template: str, **values: object) -> str:
    """A template of this package with the style and script all pages share."""
    style_text, script = (Markup(_text(name)) for name in ("report.css", "report.js"))
    return _environment().get_template(template).render(style=style_text, script=script, **values)


def _text(name: str) -> str:
    return (files("turtlebag.reports") / "templates" / name).read_text()


@cache
def _environment() -> Environment:
    """The templates, compiled once: that takes longer than filling them."""
    environment = Environment(
        loader=FunctionLoader(_text),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["themed"] = themed
    environment.filters["explained"] = explained
    environment.globals["shown"] = shown
    environment.filters["short"] = lambda digest: digest[:12]
    return environment


def themed(svg: str) -> Markup:
    """An SVG whose ink and paper follow the page's theme."""
    for colour, variable in THEMED.items():
        svg = svg.replace(colour, variable)
    return Markup(svg)


def overall(chapters: Sequence[Chapter]) -> tuple[str, str]:
    """Mood and headline of the whole report: its tasks, and where there are none what else there is."""
    parts = [part for chapter in chapters for part in chapter.parts]
    runs = [part for part in parts if part.stage.kind == "navigate"]
    if runs:
        good = sum(part.verdict[0] == GOOD for part in runs)
        believed = sum(part.believed for part in runs)
        aside = f"; the robot reported {believed}" if believed != good else ""
        headline = f"{good} of {counted(len(runs), 'task')} succeeded{aside}"
        return (GOOD if good == len(runs) else BAD), headline
    mood = overall_mood(part.verdict[0] for part in parts)
    counts = Counter(part.stage.kind for part in parts)
    found = [counted(counts[name], kind.noun) for name, kind in KINDS.items() if counts[name]]
    return mood, ", ".join(found) + ", no navigation"


def tiles(chapters: Sequence[Chapter]) -> list[Tile]:
    """Up to five figures over the whole report; of several worlds the worst is shown and named."""
    parts = [(chapter.name, part) for chapter in chapters for part in chapter.parts]
    runs = [part for _, part in parts if part.stage.kind == "navigate"]
    found = []
    goals = [goal for part in runs for goal in part.metrics.get("goals") or []]
    if goals:
        counts = goal_counts(goals)
        reached, believed = counts["goals_truly_reached"], counts["goals_reached"]
        mood = GOOD if reached == len(goals) else BAD
        meaning = "Goals of all runs that the robot had truly reached when it reported them as reached."
        tasks = ", ".join(part.stage.title for part in runs if part.metrics.get("goals"))
        note = f"the robot reported {believed}" if believed != reached else tasks
        found.append(Tile("goals reached", f"{reached} of {len(goals)}", note, meaning, mood))
    if runs:
        hits = sum(collision_count(part.metrics) for part in runs)
        meaning = (
            "Episodes of contact with anything but the floor, over all runs, as counted by the simulator."
        )
        note = f"in {counted(len(runs), 'run')}"
        found.append(Tile("collisions", str(hits), note, meaning, BAD if hits else GOOD))
    for path, label, worst, kinds in (
        ("ate_m.rmse", "map trajectory error, RMSE", max, ("map",)),
        ("relations.trans_m.mean", "relations error", max, ("map",)),
        ("localisation_error_m.rmse", "localisation error, RMSE", max, ("navigate", "localise")),
        ("length_m", "length of the plan", max, ("plan",)),
        ("min_clearance_m", "minimum clearance", min, ("navigate", "plan")),
        ("map.occupied_error_m.within_one_cell", "wall cells within one cell", min, ("map",)),
        ("scans", "scans", max, ("record", "map", "localise")),
    ):
        values = [
            (value, f"{name}/{part.stage.label}", f"{part.stage.title} in {name}", part.stage.kind)
            for name, part in parts
            if part.stage.kind in kinds and isinstance(value := lookup(part.metrics, path), (int, float))
        ]
        if values and not (path == "scans" and found):
            value, name, title, kind = worst(values)
            note = f"worst of {len(values)}: {title}" if len(values) > 1 else title
            spec = next(spec for spec in SPECS[kind] if spec.path == path)
            text, key = shown(value, spec.unit), f"{name}:{path}"
            found.append(Tile(label, text, note, spec.meaning, key=key, number=value))
    return found[:5]
