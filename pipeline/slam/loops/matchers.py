"""The loop matchers: our point-to-line alignment, and Open3D's ICP."""

from __future__ import annotations

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.loops.matcher import LoopMatch, Stretch
from turtlebag.pipeline.slam.scans.align import Alignment, align
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits
from turtlebag.pipeline.slam.scans.open3d_icp import match_points


class Open3dMatch:
    """Loops by Open3D's ICP: all points of the stretch on all points of the place."""

    def match(
        self, clouds: Clouds, query: Stretch, place: Stretch, start: Array, limits: Limits
    ) -> Alignment:
        """As in `LoopMatch`; there is no kernel."""
        source, target = query.points(clouds), place.points(clouds)
        found = match_points(source, target, start, limits.gate, limits.iterations)
        pose = SE2(found.T_target_source)
        return Alignment(pose, found.information, found.overlap, found.rmse, 1.0 - found.overlap)


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


MATCHERS: dict[str, type[LoopMatch]] = {"lines": LineMatch, "open3d": Open3dMatch}
"""The values of `loops.match`; see `turtlebag.pipeline.slam.loops.matcher`."""
