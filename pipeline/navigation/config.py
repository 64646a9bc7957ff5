"""All settings of a navigation run."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from pipeline.localisation.parameters import AmclConfig
from planners.control.goal_checker import GoalCheckerConfig
from planners.control.monitor import MonitorConfig
from planners.control.pursuit import PursuitConfig
from planners.costmap import CostmapConfig
from planners.global_plan import PlanConfig
from planners.live import LiveConfig
from planners.tasks.avoid import AvoidConfig
from planners.tasks.guarded import GuardConfig
from planners.tasks.recovery import RecoveryConfig
from planners.tasks.sequence import SequenceConfig
from sim.simulator import SimConfig


class NavigateConfig(BaseModel):
    """One section for each part."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    sim: SimConfig = SimConfig()
    amcl: AmclConfig = AmclConfig()
    costmap: CostmapConfig = CostmapConfig()
    live: LiveConfig = LiveConfig()
    plan: PlanConfig = PlanConfig()
    pursuit: PursuitConfig = PursuitConfig()
    monitor: MonitorConfig = MonitorConfig()
    goal_checker: GoalCheckerConfig = GoalCheckerConfig()
    sequence: SequenceConfig = SequenceConfig()
    recovery: RecoveryConfig = RecoveryConfig()
    avoid: AvoidConfig = AvoidConfig()
    guard: GuardConfig = GuardConfig()
