"""`graph.npz`: the whole graph of a map in one file, so that another recording can be added.

Scans, odometry, track, key poses, constraints and the records of loops, as plain arrays (NumPy's npz, no
pickled objects); the lists of records and the settings as JSON. Reading returns what was written, to
the last bit.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import require_bounded_zip
from turtlebag.datasets.motion import KNOTS
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.sensor_times import SensorTimes
from turtlebag.datasets.types import LidarSpec, MountedLidar, Recording
from turtlebag.datasets.yaml_files import checked
from turtlebag.pipeline.slam.graph.constraints import Constraint, Graph, Kind, Loop
from turtlebag.pipeline.slam.mapper import LATER, SlamConfig
from turtlebag.pipeline.slam.odometry.breaks import TrackBreaks
from turtlebag.pipeline.slam.odometry.calibration import Calibration
from turtlebag.pipeline.slam.odometry.evidence import evidence_of
from turtlebag.pipeline.slam.odometry.track import Track
from turtlebag.pipeline.slam.scans.range_noise import range_noise
from turtlebag.pipeline.slam.scans.scans import Scans
from turtlebag.pipeline.slam.sensors.range_calibration import RangeCalibration
from turtlebag.pipeline.slam.sensors.setup_estimate import SensorSetup
from turtlebag.pipeline.slam.sessions import Session, borders_of

FILE = "graph.npz"
FORMAT = 11
# Kind of each array - integers (i, u), numbers (f), finite numbers (n) or booleans (b) - and its shape: b
# beams, s scans, w instants of a sweep, k keys, m steps between keys; other dimensions agree where the letter
# is the same.
LAYOUT = {
    "stamps_ns": ("i", "s"),
    "ranges": ("f", "sb"),
    "T_base_lidar": ("n", "3"),
    "sensor": ("u", "s"),
    "noise": ("n", "3"),
    "covariance": ("n", "33"),
    "T_odom_base": ("n", "s3"),
    "motion": ("n", "sw3"),
    "T_map_keys": ("n", "k3"),
    "unbridged": ("b", "m"),
    "track_T_track_base": ("n", "s3"),
    "track_keys": ("i", "k"),
    "track_overlap": ("f", "s"),
    "track_rmse": ("f", "s"),
    "track_information": ("n", "s33"),
    "track_source": ("i", "s"),
    "track_odometry_steps": ("n", "m3"),
    "track_usable": ("b", "s"),
    "breaks_broken": ("b", "m"),
    "breaks_contradicted": ("b", "m"),
    "breaks_alone": ("b", "m"),
    "breaks_gaps": ("i", "g2"),
    "constraint_i": ("i", "c"),
    "constraint_j": ("i", "c"),
    "constraint_T_i_j": ("n", "c3"),
    "constraint_information": ("n", "c33"),
    "constraint_cauchy": ("n", "c"),
    "loop_i": ("i", "l"),
    "loop_j": ("i", "l"),
    "loop_T_j_i": ("n", "l3"),
    "loop_information": ("n", "l33"),
    "recognised_i": ("i", "r"),
    "recognised_j": ("i", "r"),
    "recognised_T_j_i": ("n", "r3"),
    "recognised_information": ("n", "r33"),
}
OPTIONAL = ("sensor", "T_odom_base", "motion", "track_odometry_steps")
INDICES = {
    "sensor": "lidars",
    "track_keys": "s",
    "breaks_gaps": "s",
    **{f"{record}_{end}": "k" for record in ("constraint", "loop", "recognised") for end in "ij"},
}
"""Arrays of scan, key or lidar numbers."""
POSES = ("T_base_lidar", "T_odom_base", "motion", "T_map_keys", "track_T_track_base")
RECORDS: dict[str, tuple[str, type]] = {
    "constraint": ("constraints", Constraint),
    "loop": ("loops", Loop),
    "recognised": ("recognised", Loop),
}
"""Lists of records in a `Graph`: name in the file, field, type."""
WORDS: dict[str, type] = {"kind": Kind, "verdict": str}
"""Fields of these records that are written as JSON."""
Record = TypeVar("Record")
UNREADABLE = (
    OSError, EOFError, ValueError, KeyError, TypeError, AttributeError,
    InputError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
Change = tuple[str, str, str]
"""Dotted key of a setting, its value before and now."""
FARTHEST = 1e8
"""No pose is farther away than this [m], and no weight of one is larger than its square [1/m^2]."""


def save_session(path: Path, session: Session, config: SlamConfig) -> None:
    """Write a session and its settings, without paths and times."""
    recording, track, graph = session.recording, session.track, session.graph
    about = {
        "format": FORMAT,
        "source": " + ".join(Path(part).name for part in recording.source.split(" + ")),
        "lidar": asdict(recording.lidar),
        "topic": recording.topic,
        "others": [_lidar(lidar) for lidar in recording.others],
        "settings": config.model_dump(mode="json"),
        "calibration": {k: v for k, v in vars(track.calibration).items() if np.ndim(v) == 0},
        "range_calibration": session.ranges.numbers(),
        "range_calibration_of_others": [errors.numbers() for errors in session.ranges.others],
        "sensors": session.setup.as_records(),
        "times": asdict(recording.times),
    }
    arrays = {"about": _text(about)} | ({} if session.motion is None else {"motion": session.motion.xyt})
    arrays |= _arrays("", recording) | _arrays("", track.calibration) | _arrays("", graph)
    arrays |= _arrays("track_", track) | _arrays("breaks_", session.breaks)
    for name, (of, kind) in RECORDS.items():
        arrays |= _columns(name, getattr(graph, of), kind)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_session(folder: Path) -> tuple[Session, SlamConfig]:
    """The session of a map's folder and its settings; InputError if there is none that can be read."""
    path = folder / FILE
    if not path.is_file():
        raise InputError(f"{folder}: no {FILE} to continue from; map its recording again")
    try:
        require_bounded_zip(path)
        with np.load(path, allow_pickle=False) as stored:
            return _session({name: stored[name] for name in stored.files})
    except UNREADABLE as error:
        raise InputError(f"{path}: not a readable graph ({error})") from None


def require_same_front_end(folder: Path, before: SlamConfig, now: SlamConfig) -> list[str]:
    """InputError if continuing from `folder` would mix scans tracked with different settings.

    What comes later - loops, refinement, grid - is computed from all scans together, so its settings may
    change: returns a line for each that does.
    """
    notes = []
    for key, was, is_now in _changes(before.model_dump(mode="json"), now.model_dump(mode="json")):
        if key.split(".")[0] not in LATER:
            raise InputError(
                f"--continue {folder}: its graph was made with {key}={was}, not {is_now}; "
                f"give --set {key}={was}, or map its recording again"
            )
        notes.append(f"--continue {folder}: {key} was {was} there; now {is_now} for all sessions")
    return notes


def _changes(before: Mapping[str, Any], now: Mapping[str, Any], path: str = "") -> Iterator[Change]:
    for key, was in before.items():
        if isinstance(was, Mapping):
            yield from _changes(was, now[key], f"{path}{key}.")
        elif was != now.get(key):
            yield f"{path}{key}", json.dumps(was), json.dumps(now.get(key))


def _session(stored: dict[str, Any]) -> tuple[Session, SlamConfig]:
    about = json.loads(bytes(stored["about"]))
    if about["format"] != FORMAT:
        has = about["format"]
        raise ValueError(f"format {has}, but this version reads {FORMAT}; map its recording again")
    others = tuple(_other(one) for one in about.get("others", []))
    calibration_of: dict[str, Any] = _finite(about["calibration"])
    errors = map(_finite, [about["range_calibration"], *about.get("range_calibration_of_others", [])])
    ranges, *more = (RangeCalibration(one["offset_m"], one["square_per_m"]) for one in errors)
    config = checked(SlamConfig, about["settings"], where="its settings")
    calibration_of["pairs"], lidar = int(calibration_of["pairs"]), _spec(about["lidar"])
    _check(stored, [lidar.n_beams, *(other.spec.n_beams for other in others)])
    named = {"source": str(about["source"]), "topic": str(about.get("topic", ""))}
    times = SensorTimes.of_record(about.get("times", {}))
    recording = _record(Recording, "", stored, **named, lidar=lidar, others=others, times=times)
    if others and recording.sensor is None:
        raise ValueError("which lidar took a scan is missing")
    calibration = _record(Calibration, "", stored, **calibration_of)
    track = _record(Track, "track_", stored, calibration=calibration)
    records = {of: _rows(name, stored, kind) for name, (of, kind) in RECORDS.items()}
    graph, usable = _record(Graph, "", stored, **records), config.usable(*recording.lidars)
    scans = Scans(recording, usable, range_noise(recording, usable), _value("motion", stored))
    borders = borders_of(graph.constraints, track.keys)
    return Session(
        recording=recording,
        key_scans=scans.of_keys(track.keys),
        motion=scans.motion,
        track=track,
        evidence=evidence_of(recording, track, config.tracking.odometry, borders),
        breaks=_record(TrackBreaks, "breaks_", stored),
        graph=graph,
        ranges=replace(ranges, others=tuple(more)),
        setup=SensorSetup.of_records(about.get("sensors", [])),
    ), config


def _lidar(lidar: MountedLidar) -> dict[str, Any]:
    T = lidar.T_base_lidar.xyt.tolist()
    return {"lidar": asdict(lidar.spec), "T_base_lidar": T, "topic": lidar.topic}


def _other(stored: dict[str, Any]) -> MountedLidar:
    x, y, yaw = _finite(dict(zip("xyt", stored["T_base_lidar"], strict=True))).values()
    return MountedLidar(_spec(stored["lidar"]), SE2.from_xyt(x, y, yaw), str(stored["topic"]))


def _spec(stored: dict[str, Any]) -> LidarSpec:
    lidar: dict[str, Any] = _finite(stored)
    # earlier versions took a negative increment as beams before the stamp
    if lidar.setdefault("first_beam", -1.0) < 0.0 and lidar["time_increment"] < 0.0:
        raise ValueError("its sweep runs backwards, as earlier versions read it; map its recording again")
    lidar["n_beams"], lidar["first_beam"] = int(lidar["n_beams"]), max(int(lidar["first_beam"]), 0)
    return LidarSpec(**lidar)


def _finite(stored: dict[str, Any]) -> dict[str, float]:
    numbers = {name: float(value) for name, value in stored.items()}
    if not np.isfinite([*numbers.values()]).all():
        raise ValueError("its lidar or its calibration is invalid")
    return numbers


def _check(stored: dict[str, Any], beams: Sequence[int]) -> None:
    """ValueError unless every array has its kind and shape and points at existing rows: the compiled code
    that reads them does not check again."""
    keys = len(stored["track_keys"])
    sizes = {"lidars": len(beams), "b": max(beams), "k": keys, "m": keys - 1, "w": KNOTS, "2": 2, "3": 3}
    for name, (kind, shape) in LAYOUT.items():
        if name not in stored and name in OPTIONAL:
            continue
        array = stored[name]
        if array.shape == (0,) and len(shape) > 1 and sizes.setdefault(shape[0], 0) == 0:
            continue  # no record of this kind
        expected = tuple(
            sizes.setdefault(letter, size) for letter, size in zip(shape, array.shape, strict=False)
        )
        if array.ndim != len(shape) or array.shape != expected:
            raise ValueError(f"{name} is inconsistent with the rest")
        # an array without rows is written without a type, whatever its rows would hold
        if array.dtype.kind != {"n": "f"}.get(kind, kind) and array.size:
            raise ValueError(f"{name} has the wrong type")
        largest = FARTHEST if "T_" in name else FARTHEST**2
        if kind == "n" and array.size and not np.abs(array).max() <= largest:
            raise ValueError(f"{name} has impossible values")
        limit = sizes.get(INDICES.get(name, ""))
        if limit is not None and array.size and not 0 <= array.min() <= array.max() < limit:
            raise ValueError(f"{name} refers to missing entries")
    if keys == 0 or (np.diff(stored["track_keys"]) <= 0).any():
        raise ValueError("its keys are not in order")


def _text(value: object) -> Any:
    return np.frombuffer(json.dumps(value).encode(), dtype=np.uint8)


def _arrays(prefix: str, record: Any) -> dict[str, Any]:
    """The fields of a record that LAYOUT names and that are there, poses as plain arrays."""
    values = {f"{prefix}{f.name}": getattr(record, f.name) for f in fields(record)}
    return {
        name: value.xyt if isinstance(value, SE2) else value
        for name, value in values.items()
        if name in LAYOUT and value is not None
    }


def _value(name: str, stored: dict[str, Any]) -> Any:
    """A stored field, None if it is not there."""
    value = stored.get(name)
    return SE2(value) if name in POSES and value is not None else value


def _record(kind: type[Record], prefix: str, stored: dict[str, Any], **others: Any) -> Record:
    """A record from its stored fields and `others`."""
    names = {f.name: f"{prefix}{f.name}" for f in fields(kind)}  # type: ignore[arg-type]
    return kind(**{field: _value(name, stored) for field, name in names.items() if name in LAYOUT}, **others)


def _columns(name: str, rows: Sequence[Any], kind: type) -> dict[str, Any]:
    """Records as one array a field; words as JSON."""
    out: dict[str, Any] = {}
    for field in fields(kind):
        column = [getattr(row, field.name) for row in rows]
        out[f"{name}_{field.name}"] = _text(column) if field.name in WORDS else np.array(column)
    return out


def _rows(name: str, stored: dict[str, Any], kind: type) -> list[Any]:
    columns = []
    for field in fields(kind):
        column = stored[f"{name}_{field.name}"]
        if word := WORDS.get(field.name):
            columns.append([word(one) for one in json.loads(bytes(column))])
        else:
            # scalars as Python's own, so that they are written as the same text
            columns.append(column.tolist() if column.ndim == 1 else list(column))
    rows = [kind(*row) for row in zip(*columns, strict=True)]
    # files of earlier versions call a border a loop
    return [replace(c, kind=Kind.BORDER) if _is_border(c) else c for c in rows]


def _is_border(c: Constraint | Loop) -> bool:
    return isinstance(c, Constraint) and c.kind is Kind.LOOP and c.j == c.i + 1
