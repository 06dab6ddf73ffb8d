"""Values that travel between the stages: scans, features, candidates, results.

Conventions: metres and radians; OpenCV camera axes (x right, y down, z forward);
``target_T_source`` maps source points into the target frame; ``world_T_scan`` is camera-to-world.
Poses are (4, 4) float64 arrays.
"""

from fewview.types.arrays import Array, BoolArray, FloatArray, IntArray
from fewview.types.completed import (
    CompletedScan,
    FeatureSet,
    Levelling,
    PlanarPatch,
    Representation,
    Surface,
)
from fewview.types.pairs import (
    CandidateOrigin,
    Correspondences,
    Evidence,
    PairResult,
    PairStatus,
    PoseCandidate,
    Scales,
)
from fewview.types.results import (
    Alternative,
    AlternativePlace,
    ColouredMesh,
    Component,
    EdgeReport,
    GlobalSolution,
    Observer,
    Reconstruction,
    Registration,
    ScanPlacement,
)
from fewview.types.rooms import (
    CompletedLayout,
    CompletedPanorama,
    CompletedPlanes,
    CompletedRoom,
    RingScan,
    StructuralPlane,
)
from fewview.types.scans import Frame, FrameSource, Intrinsics, Scan, ScanSet

__all__ = [
    "Alternative",
    "AlternativePlace",
    "Array",
    "BoolArray",
    "CandidateOrigin",
    "ColouredMesh",
    "CompletedLayout",
    "CompletedPanorama",
    "CompletedPlanes",
    "CompletedRoom",
    "CompletedScan",
    "Component",
    "Correspondences",
    "EdgeReport",
    "Evidence",
    "FeatureSet",
    "FloatArray",
    "Frame",
    "FrameSource",
    "GlobalSolution",
    "IntArray",
    "Intrinsics",
    "Levelling",
    "Observer",
    "PairResult",
    "PairStatus",
    "PlanarPatch",
    "PoseCandidate",
    "Reconstruction",
    "Registration",
    "Representation",
    "RingScan",
    "Scales",
    "Scan",
    "ScanPlacement",
    "ScanSet",
    "StructuralPlane",
    "Surface",
]
