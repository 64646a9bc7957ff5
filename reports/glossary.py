"""The words of a report a newcomer may not know, and how they are linked where they stand."""

from __future__ import annotations

import re
from dataclasses import dataclass

from markupsafe import Markup, escape

from turtlebag.reports.stage_titles import slug


@dataclass(frozen=True)
class Word:
    """A word with its meaning in one or two sentences; `forms` are spellings besides the name."""

    name: str
    meaning: str
    forms: tuple[str, ...] = ()

    @property
    def anchor(self) -> str:
        """Fragment of the page's address."""
        return f"word-{slug(self.name)}"


WORDS = (
    Word(
        "odometry",
        "The robot's pose computed from the rotation of its wheels. Accurate over a metre; over longer "
        "distances, slip and small errors of the wheel size accumulate.",
    ),
    Word(
        "SLAM",
        "Simultaneous localisation and mapping: the path and the map are estimated together from lidar "
        "scans and odometry.",
    ),
    Word(
        "key scan",
        "One of the scans that are nodes of the pose graph: a new one is taken after a set distance or turn.",
        ("key scans",),
    ),
    Word(
        "scan",
        "One revolution of the lidar: the distance to the nearest object in each direction.",
        ("scans",),
    ),
    Word("cell", "One square of the map: free, occupied or unknown; usually 5 cm wide.", ("cells",)),
    Word("truth", "Ground truth: the robot's real pose, which the simulator knows. No algorithm reads it."),
    Word("yaw", "Heading: the angle from the x axis, positive to the left."),
    Word("RMSE", "Root mean square error: like a mean, but large errors count more."),
    Word(
        "ATE", "Absolute trajectory error: the distance between estimated and true position, over all scans."
    ),
    Word(
        "drift per metre",
        "Relative pose error (RPE): the error over one metre of path, wherever it starts.",
    ),
    Word(
        "alignment",
        "Moving the whole path rigidly onto the truth before measuring. Simulated maps are measured "
        "without it, because map and world share their origin.",
    ),
    Word(
        "loop",
        "A loop closure: a place recognised on a later visit. It ties the two visits together and "
        "removes the drift between them.",
        ("loops",),
    ),
    Word(
        "pose graph",
        "Key scans joined by measured relative poses; SLAM moves them until the measurements agree best.",
    ),
    Word(
        "IoU",
        "Intersection over union: cells that are wall in both maps, divided by cells that are wall in "
        "either.",
    ),
    Word(
        "AMCL",
        "Adaptive Monte Carlo localisation: many hypotheses (particles) of the robot's pose, moved "
        "with the odometry and weighted by how well the scan fits the map.",
        ("particle filter",),
    ),
    Word("footprint", "The outline of the robot on the floor."),
    Word("clearance", "The distance between the footprint and the nearest surface."),
    Word("goal checker", "Decides when a goal is reached; it knows only the robot's estimate."),
)


def explained(text: str) -> Markup:
    """A text as HTML, each word's first appearance linked to its explanation."""
    marked = str(escape(text))
    links: list[str] = []
    for word in WORDS:
        spelled = "|".join(re.escape(form) for form in (*word.forms, word.name))
        match = re.search(rf"(?<![\w-])({spelled})(?![\w-])", marked)
        if match is not None:
            # A placeholder, so that no other word is found inside the link.
            marked = f"{marked[: match.start()]}\0{len(links)}\0{marked[match.end() :]}"
            title = escape(word.meaning)
            links.append(f'<a class="word" href="#{word.anchor}" title="{title}">{match[1]}</a>')
    for number, link in enumerate(links):
        marked = marked.replace(f"\0{number}\0", link)
    return Markup(marked)
