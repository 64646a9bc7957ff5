"""What is wrong with a bag: one vocabulary for its readers, `bag doctor`, maps and pages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError

Severity = Literal["error", "warning", "note"]
"""A note is no defect: it says which of several things is used, and how."""


class Kind(NamedTuple):
    """How grave findings of a kind are, and what they break in other tools or in ours."""

    severity: Severity
    breaks: str = ""


KINDS: dict[str, Kind] = {
    "missing metadata": Kind("error", "`ros2 bag` and most readers refuse the folder"),
    "damaged file": Kind("error", "readers that need the index refuse the file"),
    "damaged messages": Kind("error", "what they said is lost"),
    "unknown types": Kind("note"),
    "two types": Kind("error", "`ros2 bag play` and subscribers get one of them or none"),
    "no scans": Kind("error", "there is nothing to map or localise with"),
    "no odometry": Kind("warning", "mapping has only the scans; AMCL cannot run"),
    "odometry source": Kind("note"),
    "pose not filled in": Kind("error", "whatever reads the pose sees a robot that never moves"),
    "repeated poses": Kind("note"),
    "no time": Kind("error", "tf2 and message filters cannot match by it"),
    "time goes backwards": Kind(
        "error", "TF buffers are cleared, and message filters drop everything older than what they have seen"
    ),
    "repeated stamps": Kind("warning", "interpolation between them is undefined"),
    "mixed clocks": Kind(
        "error", "no odometry or transform matches the scans in time (use_sim_time set on some nodes only?)"
    ),
    "gaps": Kind("warning", "the motion across a gap is a guess; lookups of transforms in it are refused"),
    "beyond odometry": Kind("warning", "there is no transform for these scans; the motion is a guess"),
    "no static transforms": Kind("error", "the laser's position on the robot is unknown"),
    "frames do not connect": Kind(
        "error",
        "message filters drop the scans, viewers stay blank: a place on the robot is unknown",
    ),
    "two parents": Kind("error", "the tree flickers between them (two nodes publish the same transform?)"),
    "transform loop": Kind("error", "tf2 refuses every lookup through it"),
    "bad quaternions": Kind("error", "tf2 refuses them"),
    "truth in /tf": Kind("warning", "a mapper that uses /tf may read the ground truth"),
    "mixed frames": Kind("error", "two sensors or robots on one topic look like one that jumps"),
    "absurd places": Kind("error", "viewers break"),
    "millimetres": Kind("error", "other readers take them for metres"),
    "mounting": Kind("note"),
    "beam angles": Kind("error", "the directions of the readings are unknown"),
    "scans left out": Kind("note"),
    "several lidars": Kind("note"),
    "fence-post": Kind(
        "warning", "slam_toolbox and Karto refuse such scans, others shift each beam a little"
    ),
    "range limits": Kind("error", "no reading is valid"),
    "empty scans": Kind("warning", "they cannot be matched; the motion is a guess"),
    "zero readings": Kind("warning", "old drivers mean 'no return' by it; free space stays unknown"),
    "no-return readings": Kind("note"),
    "sweep time": Kind("warning", "deskewing distorts the scans"),
    "quality of service": Kind("warning", "with `ros2 bag play`, nodes that start later never receive it"),
}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong with a topic, link or file of a bag.

    `kind` is a key of KINDS, `detail` the observation, `count` how many messages (or readings) it concerns,
    `first_ns` the recording time of the first one, `remedy` what our readers do about it or the user can do.
    """

    kind: str
    topic: str
    detail: str
    count: int = 1
    first_ns: int | None = None
    remedy: str = ""

    @property
    def severity(self) -> Severity:
        """How grave it is."""
        return KINDS[self.kind].severity

    @property
    def breaks(self) -> str:
        """What it breaks."""
        return KINDS[self.kind].breaks

    @property
    def what(self) -> str:
        """The observation, with its topic."""
        return f"{self.topic}: {self.detail}" if self.topic else self.detail

    def __str__(self) -> str:
        return f"{self.what}; {self.remedy}" if self.remedy else self.what

    def as_metrics(self) -> dict[str, object]:
        """What metrics.json holds of it."""
        return {
            "kind": self.kind,
            "severity": self.severity,
            "topic": self.topic,
            "count": self.count,
            "first_s": None if self.first_ns is None else seconds(self.first_ns),
            "text": str(self),
        }


class Unusable(InputError):
    """A recording that cannot be mapped because of a finding."""

    def __init__(self, path: Path, finding: Finding) -> None:
        super().__init__(f"{path}: {finding}")
        self.finding = finding


def metrics_of(findings: Iterable[Finding]) -> dict[str, list[dict[str, object]]]:
    """Findings as `findings` of metrics.json; nothing without any."""
    rows = [finding.as_metrics() for finding in dict.fromkeys(findings)]
    return {"findings": rows} if rows else {}


def lines_of(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Findings as text, each once."""
    return tuple(dict.fromkeys(map(str, findings)))
