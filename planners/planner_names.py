"""Names of the available OMPL planners, so that help texts need not import OMPL."""

from typing import Literal

PlannerName = Literal[
    "RRTConnect",
    "RRT",
    "RRTstar",
    "InformedRRTstar",
    "SORRTstar",
    "AORRTC",
    "BITstar",
    "FMT",
    "BFMT",
    "KPIECE1",
    "BKPIECE1",
    "LBKPIECE1",
    "PRM",
    "PRMstar",
]
