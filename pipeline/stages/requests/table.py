"""All requests, by what they are called on the command line."""

from __future__ import annotations

from turtlebag.pipeline.stages.requests.bags import ConvertRequest, RecoverRequest
from turtlebag.pipeline.stages.requests.courses import GradeRequest
from turtlebag.pipeline.stages.requests.drives import KeyboardRequest, NavigateRequest, RecordRequest
from turtlebag.pipeline.stages.requests.maps import LocaliseRequest, MapRequest, PlanRequest
from turtlebag.pipeline.stages.requests.pages import CompareRequest, ReportRequest
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.pipeline.stages.requests.robots import IdentifyRequest, TwinRequest
from turtlebag.pipeline.stages.requests.studio import StudioRequest

KINDS: tuple[type[Request], ...] = (
    RecordRequest,
    KeyboardRequest,
    MapRequest,
    LocaliseRequest,
    IdentifyRequest,
    TwinRequest,
    PlanRequest,
    NavigateRequest,
    ReportRequest,
    CompareRequest,
    GradeRequest,
    ConvertRequest,
    RecoverRequest,
    StudioRequest,
)
REQUESTS = {kind.VERB: kind for kind in KINDS}
