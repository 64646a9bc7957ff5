"""Messages of a header, texts and numbers, decoded many at a time: the same texts make the same layout."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from turtlebag.datasets.bags.decode import BadMessage, Cursor
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps

# So many messages are kept as bytes until they are decoded together.
BLOCK = 4096
# In ROS 2's layout as in ROS 1's: before the stamp stands an encapsulation, or a sequence number.
STAMP, TEXTS = 4, 12


class Layout(NamedTuple):
    """What follows the frame: so many texts, then so many float64, of which those at `wanted` are kept."""

    texts: int
    numbers: int
    wanted: tuple[int, ...]


POSES = {
    "nav_msgs/msg/Odometry": Layout(1, 49, (0, 1, 3, 4, 5, 6, 43, 44, 48)),
    "geometry_msgs/msg/PoseStamped": Layout(0, 7, (0, 1, 3, 4, 5, 6)),
    "geometry_msgs/msg/PoseWithCovarianceStamped": Layout(0, 7, (0, 1, 3, 4, 5, 6)),
}
"""x and y [m], and the quaternion x, y, z, w; of odometry also the speeds of the child frame, forward, to the
left [m/s] and its turn [rad/s]. After the pose come its covariance, the twist and that one's covariance."""
SAMPLES = Layout(0, 37, (13, 14, 15, 25, 26, 27))
"""Those of an IMU, sensor_msgs/Imu: turn [rad/s] and specific force [m/s^2], both (3,)."""


class _Made(NamedTuple):
    """How messages with the same texts are made: their first bytes, the texts, all up to the last number."""

    head: bytes
    raw: bytes
    texts: tuple[str, ...]
    dtype: np.dtype

    def fits(self, data: bytes) -> bool:
        """Whether a message is made so."""
        own = data.startswith(self.head) and data.startswith(self.raw, TEXTS)
        return own and len(data) >= self.dtype.itemsize


class Columns:
    """The intact messages of a topic in their order; the log times [ns] of the others are `damaged`."""

    def __init__(self, layout: Layout, cursor: Callable[[bytes], Cursor]) -> None:
        self.damaged: list[int] = []
        self.texts: list[tuple[str, ...]] = []
        """The frame and the other texts of a message, whatever of that there is in the topic."""
        self._layout, self._cursor = layout, cursor
        self._waiting: list[tuple[int, bytes]] = []
        self._blocks: list[tuple[Stamps, Stamps, Stamps, Array]] = []

    def add(self, log_time_ns: int, data: bytes) -> None:
        """The next message."""
        self._waiting.append((log_time_ns, data))
        if len(self._waiting) == BLOCK:
            self._decode()

    def arrays(self) -> tuple[Stamps, Stamps, Stamps, Array]:
        """Stamps and log times [ns] (n,), the place of each message's texts in `texts` (n,), and its wanted
        numbers (n, k)."""
        self._decode()
        stamps, times, texts, numbers = map(np.concatenate, zip(*self._blocks, strict=True))
        self._blocks = [(stamps, times, texts, numbers)]
        return self._blocks[0]

    def _decode(self) -> None:
        """Decode the messages that wait."""
        waiting, self._waiting = self._waiting, []
        alike: dict[_Made, list[int]] = {}
        made, those = None, list[int]()
        for k, (log_time, data) in enumerate(waiting):
            if made is None or not made.fits(data):
                try:
                    made = self._made(data)
                except BadMessage:
                    self.damaged.append(log_time)
                    continue
                those = alike.setdefault(made, [])
            those.append(k)
        intact = np.zeros(len(waiting), dtype=bool)
        stamps, texts = (np.zeros(len(waiting), dtype=np.int64) for _ in range(2))
        numbers = np.zeros((len(waiting), len(self._layout.wanted)))
        for of_all, those in alike.items():
            size = of_all.dtype.itemsize
            block = np.frombuffer(b"".join([waiting[k][1][:size] for k in those]), of_all.dtype)
            stamps[those] = block["sec"].astype(np.int64) * 10**9 + block["nanosec"]
            numbers[those] = block["numbers"][:, self._layout.wanted]
            if of_all.texts not in self.texts:
                self.texts.append(of_all.texts)
            texts[those], intact[those] = self.texts.index(of_all.texts), True
        times = np.array([time for time, _ in waiting], dtype=np.int64)
        self._blocks.append((stamps[intact], times[intact], texts[intact], numbers[intact]))

    def _made(self, data: bytes) -> _Made:
        """How a message is made; BadMessage for none."""
        cursor = self._cursor(data)
        _, frame = cursor.header()
        texts = frame, *(cursor.string() for _ in range(self._layout.texts))
        end = cursor.at
        cursor.take("d", self._layout.numbers)
        order, first = cursor.order, cursor.at - 8 * self._layout.numbers
        fields: Any = {
            "names": ["sec", "nanosec", "numbers"],
            "formats": [f"{order}i4", f"{order}u4", (f"{order}f8", (self._layout.numbers,))],
            "offsets": [STAMP, STAMP + 4, first],
            "itemsize": cursor.at,
        }
        return _Made(data[: cursor.origin], data[TEXTS:end], texts, np.dtype(fields))
