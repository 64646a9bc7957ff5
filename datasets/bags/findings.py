"""What the doctor of bags says, and of which messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning"]
SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True, slots=True)
class Finding:
    """One defect: how grave, which check, what was seen and what it would break."""

    severity: Severity
    check: str
    what: str
    breaks: str
