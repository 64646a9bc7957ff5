"""All settings of a navigation run."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from turtlebag.datasets.parts import part_of
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.localisation.localisers import LocaliserName
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.navigation.pose_watch import RelocaliseConfig
from turtlebag.pipeline.navigation.teleop_override import TeleopOverrideConfig
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.planners.control.dwa import DwaConfig
from turtlebag.planners.control.goal_checker import GoalCheckerConfig
from turtlebag.planners.costmap import CostmapConfig
from turtlebag.planners.planner import PlanConfig
from turtlebag.planners.tasks.patrol import SequenceConfig
from turtlebag.planners.tasks.recovery import RecoveryConfig, Rung
from turtlebag.planners.tasks.sector_rule import AvoidConfig
from turtlebag.sim.simulator import SimConfig

ControllerName = Annotated[str, part_of("pursuit", "dwa")]


class MaplessConfig(Settings, allow_inf_nan=False):
    """Mapless goals: the costmap is a rolling window around the robot."""

    window: float = Field(default=16.0, ge=4.0, le=100.0)
    """Side of the rolling window [m]; what leaves it is forgotten."""
    controller: ControllerName = "dwa"
    """Controller of goals without a map: `pursuit`, `dwa`, or your own class."""
    recovery: RecoveryConfig = RecoveryConfig(
        ladder=(
            Rung(kind="back_up", amount=0.25),
            Rung(kind="wait", amount=1.0),
            Rung(kind="back_up", amount=0.4),
            Rung(kind="rotate", amount=1.6),
            Rung(kind="wait", amount=2.0),
            Rung(kind="clear"),
            Rung(kind="back_up", amount=0.4),
            Rung(kind="wait", amount=4.0),
        ),
        stuck_time=1.0,
        back_up_v=0.2,
    )
    """Replaces `recovery`: in unknown surroundings, backing out comes before waiting."""


class ExploreConfig(Settings, allow_inf_nan=False):
    """Mapping during exploration."""

    slam: SlamConfig = SlamConfig()


class NavigateConfig(Settings, allow_inf_nan=False):
    """The settings of `navigate`, one section per component."""

    RENAMED: ClassVar = {"takeover": "teleop_override"}

    sim: SimConfig = SimConfig()
    localiser: LocaliserName = "amcl"
    amcl: AmclConfig = AmclConfig()
    costmap: CostmapConfig = CostmapConfig()
    mapless: MaplessConfig = MaplessConfig()
    plan: PlanConfig = PlanConfig()
    controller: ControllerName = "pursuit"
    """Controller on a map: `pursuit`, `dwa`, or your own class."""
    dwa: DwaConfig = DwaConfig()
    goal_checker: GoalCheckerConfig = GoalCheckerConfig()
    sequence: SequenceConfig = SequenceConfig()
    relocalise: RelocaliseConfig = RelocaliseConfig()
    explore: ExploreConfig = ExploreConfig()
    recovery: RecoveryConfig = RecoveryConfig()
    avoid: AvoidConfig = AvoidConfig()
    teleop_override: TeleopOverrideConfig = TeleopOverrideConfig()
