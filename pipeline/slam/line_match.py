"""Our loop matcher: point-to-line alignment."""

from __future__ import annotations

from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.clouds import Clouds
from turtlebag.pipeline.slam.correspondences import Limits
from turtlebag.pipeline.slam.loop_match import Stretch
from turtlebag.pipeline.slam.open3d_icp import Open3dMatch
from turtlebag.pipeline.slam.point_to_line_icp import Alignment, align


class LineMatch:
    """Point to line; scans without surfaces (posts, legs) are left to Open3D."""

    def __init__(self) -> None:
        self._points = Open3dMatch()

    def match(
        self, clouds: Clouds, query: Stretch, place: Stretch, start: Array, limits: Limits
    ) -> Alignment:
        """As in `LoopMatch`; of the query only the scan `about` is used, if it has surfaces."""
        if clouds.placed_by(query.about) == "points":
            return self._points.match(clouds, query, place, start, limits)
        return align(clouds, query.about, start, place.scans, place.T_about_scans, limits)
