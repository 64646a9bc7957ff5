"""Stage outputs grouped by the world or log they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from turtlebag.reports.kinds import KINDS
from turtlebag.reports.stage_titles import names_of, unique_names
from turtlebag.reports.stages import Group, Stage


def group_stages(stages: Sequence[Stage]) -> list[Group]:
    """Stages of one world, and those that share data files with them by hash, together; in order of
    first appearance. Stages of two named worlds are never one group, whatever they share.
    """
    clusters: list[list[Stage]] = []
    for stage in stages:
        related = [cluster for cluster in clusters if _related(stage, cluster)]
        if not related:
            clusters.append([stage])
            continue
        first, *others = related
        first.append(stage)
        for other in others:
            if _world(other) in (None, _world(first)):
                first += other
                clusters.remove(other)
    order = {id(stage): index for index, stage in enumerate(stages)}
    ordered = sorted(
        (sorted(members, key=lambda stage: order[id(stage)]) for members in clusters),
        key=lambda members: order[id(members[0])],
    )
    groups = [_group(members) for members in ordered]
    names = unique_names([group.name for group in groups])
    return [replace(group, name=name) for group, name in zip(groups, names, strict=True)]


def _related(stage: Stage, cluster: Sequence[Stage]) -> bool:
    world, theirs = stage.fact("world"), _world(cluster)
    if world is not None and theirs is not None:
        return world == theirs
    return any(stage.linking_hashes() & other.linking_hashes() for other in cluster)


def _world(cluster: Sequence[Stage]) -> str | None:
    return next((world for stage in cluster if (world := stage.fact("world")) is not None), None)


def _group(members: list[Stage]) -> Group:
    worlds = [world for stage in members if (world := stage.fact("world")) is not None]
    name = Path(worlds[0]).stem if worlds else _source_name(members[0])
    ordered = sorted(members, key=lambda stage: list(KINDS).index(stage.kind))
    names = names_of(ordered, Group(name, tuple(ordered)).record_of)
    return Group(
        name,
        tuple(
            replace(stage, label=label, title=title)
            for stage, (label, title) in zip(ordered, names, strict=True)
        ),
    )


def _source_name(stage: Stage) -> str:
    paths = list(stage.input_paths().values())
    if not paths:
        return stage.label
    path = paths[0].parent if paths[0].name == "bag" else paths[0]
    return path.name.split(".")[0] or stage.label
