"""What is known of when the sensors of a log measured, apart from what their stamps say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple


class Estimate(NamedTuple):
    """A value and its standard deviation."""

    value: float
    sigma: float


@dataclass(frozen=True)
class SensorTimes:
    """The times of odometry and lidar as estimated from both; None where the drive does not show them.

    `delay_s` is how late the odometry is [s], negative if it is early. `sweep` is how long the lidar takes
    for its beams, as a share of the time from scan to scan, negative if it takes them in the opposite order
    to the array's; `first_beam` is the beam with which it begins. `upside_down` says whether it is mounted
    the other way up than declared. `apart_s` [s], if not 0, is a time between parts of the array that no
    sweep explains. `sectors_s` are the times of equal parts of the array, as scans of turns show them.
    """

    delay_s: Estimate | None = None
    sweep: Estimate | None = None
    first_beam: Estimate | None = None
    upside_down: bool | None = None
    apart_s: float = 0.0
    sectors_s: tuple[float, ...] = ()

    @staticmethod
    def of_record(record: Mapping[str, Any]) -> SensorTimes:
        """From its fields as JSON; ValueError or TypeError if they are not its fields."""
        estimates = ("delay_s", "sweep", "first_beam")
        values = {name: Estimate(*map(float, record[name])) for name in estimates if record.get(name)}
        sectors_s = tuple(map(float, record.get("sectors_s", ())))
        return SensorTimes(**{**record, **values, "sectors_s": sectors_s})
