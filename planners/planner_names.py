"""The planners of OMPL that can be chosen, by their names there: for a help text without OMPL."""

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
