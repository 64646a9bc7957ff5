"""The words of a report a newcomer may not know, and how they are linked where they stand."""

from __future__ import annotations

import re
from dataclasses import dataclass

from markupsafe import Markup, escape


@dataclass(frozen=True)
class Word:
    """A word with its meaning in one or two sentences; `forms` are spellings besides the name."""

    name: str
    meaning: str
    forms: tuple[str, ...] = ()

    @property
    def anchor(self) -> str:
        """Fragment of the page's address."""
        return "word-" + re.sub(r"[^a-z0-9]+", "-", self.name.lower())


WORDS = (
    Word(
        "odometry",
        "Where the robot thinks it is by counting the turns of its wheels. Exact over a metre, wrong over "
        "a house: slip and a wheel a hair too large add up.",
    ),
    Word(
        "SLAM",
        "Simultaneous localisation and mapping: from lidar scans and odometry, the path and the map at once.",
    ),
    Word(
        "key scan",
        "One of the scans the map is built from, taken every so far and every so much of a turn; a node of "
        "the pose graph.",
        ("key scans",),
    ),
    Word("scan", "One turn of the lidar: the distance to what it hit in each direction.", ("scans",)),
    Word("cell", "One square of the map, free, occupied or unknown; usually 5 cm wide.", ("cells",)),
    Word("truth", "Where the robot really was, known to the simulator. No algorithm ever reads it."),
    Word("yaw", "Heading, counted from the x axis, left positive."),
    Word("RMSE", "Root mean square error: like a mean, but large errors count more."),
    Word(
        "ATE", "Absolute trajectory error: the distance between estimated and true position, over all scans."
    ),
    Word(
        "drift per metre",
        "Relative pose error (RPE): how wrong a step of one metre is, wherever it starts.",
    ),
    Word(
        "alignment",
        "Moving the whole path rigidly onto the truth before measuring. Simulated maps are measured without: "
        "map and world share their origin.",
    ),
    Word(
        "loop",
        "A loop closure: a place recognised on a later visit, which ties the path's two ends together and "
        "takes the drift out of what lies between.",
        ("loops",),
    ),
    Word("pose graph", "Key scans joined by measured steps; SLAM moves them until all agree best."),
    Word("IoU", "Intersection over union: cells both maps call wall, over cells either of them does."),
    Word(
        "AMCL",
        "Adaptive Monte Carlo localisation: many guesses (particles) of where the robot is, moved with the "
        "odometry and weighed by how well the scan fits the map there.",
        ("particle filter",),
    ),
    Word("footprint", "The outline of the robot on the floor."),
    Word("clearance", "The room between the footprint and the nearest surface."),
    Word("goal checker", "Says when a goal is reached; it knows the robot's own estimate only."),
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
