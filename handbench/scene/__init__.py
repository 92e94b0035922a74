"""What a light stage records and what a method is asked for: frozen values, validated at the border.

Units: metres, right-handed world, +y up; images linear Rec. 709, (H, W, 3) float32, premultiplied by
coverage over black. Cameras are OpenCV (x right, y down, z forward) with pixel centres at +0.5.
Light directions are unit vectors from the surface to the light.
"""

from __future__ import annotations

from .arrays import Array
from .baked import Baked
from .camera import Box, Camera, Uncalibrated
from .frame import Frame, Pose, Query, Viewpoint, needed
from .light import (
    FRAME_KINDS,
    KNOWN_LIGHTS,
    LIGHT_KINDS,
    TIMED_KINDS,
    Directional,
    Environment,
    FrameKind,
    Group,
    Known,
    Light,
    LightKind,
    Point,
    Single,
    TimedKind,
    Unknown,
    check_frame_kind,
    kind_of,
    known_leaves,
    leaves,
)
from .mesh import Mesh, Topology
from .picture import Observation, Prediction

__all__ = [
    "FRAME_KINDS",
    "KNOWN_LIGHTS",
    "LIGHT_KINDS",
    "TIMED_KINDS",
    "Array",
    "Baked",
    "Box",
    "Camera",
    "Directional",
    "Environment",
    "Frame",
    "FrameKind",
    "Group",
    "Known",
    "Light",
    "LightKind",
    "Mesh",
    "Observation",
    "Point",
    "Pose",
    "Prediction",
    "Query",
    "Single",
    "TimedKind",
    "Topology",
    "Uncalibrated",
    "Unknown",
    "Viewpoint",
    "check_frame_kind",
    "kind_of",
    "known_leaves",
    "leaves",
    "needed",
]
