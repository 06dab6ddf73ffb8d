"""What two scans say of each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from fewview.types.arrays import Array, FloatArray, IntArray
from fewview.types.completed import Representation


@dataclass(frozen=True)
class Scales:
    """How precise one kind of feature is: gamma_2 to gamma_5 of the supplementary.

    gamma_1 belongs to the descriptor and has done its work in `Correspondences.similarity`.

    Attributes:
        length_m: gamma_2, metres.
        normal_angle: gamma_3, radians; direction_angle: gamma_4 and gamma_5, radians.
        normal_weight: what its normals count against its positions in the rigid fit, square metres.
        fixed_point: False where a position is no exact point: a patch's centre may shift along the
            surface, what was predicted is off by decimetres. Such features propose poses but do
            not pull at them in the refinement.
    """

    length_m: float
    normal_angle: float
    direction_angle: float
    normal_weight: float
    fixed_point: bool = True


@dataclass(frozen=True)
class Correspondences:
    """Candidate matches between the same kind of features of two scans.

    Attributes:
        kind: the FeatureSet kind.
        indices: (m, 2) int64, index into the source and the target feature set.
        similarity: (m,) float32 in 0..1, s_c of the paper.
        scales: how precise these features are.
    """

    kind: str
    indices: IntArray
    similarity: FloatArray
    scales: Scales

    def __len__(self) -> int:
        return len(self.indices)


class CandidateOrigin(StrEnum):
    """Which step proposed a candidate pose; ``GIVEN`` ones come from the user and are exact."""

    SPECTRAL = "spectral"
    COMPLETION = "completion"
    ALIGNMENT = "alignment"
    MANHATTAN = "manhattan"
    TOGETHER = "together"
    GIVEN = "given"


@dataclass(frozen=True)
class Evidence:
    """What speaks for and against a candidate, measured after refinement.

    Attributes:
        residual_m: robust mean distance between nearest surface points that overlap, metres.
        overlap: share 0..1 of the smaller surface that has a neighbour in the other.
        free_space_violation: share 0..1 of the points visible to the other camera that lie in
            front of the surface it measured.
        support: number of correspondences that agree with the pose, per representation.
        features: further named quantities that the calibrated probability uses.
    """

    residual_m: float
    overlap: float
    free_space_violation: float
    support: Mapping[Representation, int]
    features: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class PoseCandidate:
    """One of the K answers for a pair.

    Attributes:
        rank: 0 for the first of the pair; see `choice`.
        target_T_source: (4, 4).
        score: spectral score of its correspondence set.
        probability: calibrated 0..1 that it is within 15 degrees and 0.3 m of the truth.
        covariance: (6, 6) of xi in target_T_source @ exp(xi), rotation (rad) before translation
            (m): the order of GTSAM's Pose3.
        matches: agreeing correspondences, (m, 2) indices per feature kind.
        told: whether the user says that it is right.
        vetoed: whether the user says that it is wrong; its probability is 0 then.
    """

    rank: int
    target_T_source: Array
    origin: CandidateOrigin
    score: float
    probability: float
    evidence: Evidence
    covariance: Array
    matches: Mapping[str, IntArray] = field(default_factory=dict)
    told: bool = False
    vetoed: bool = False


class PairStatus(StrEnum):
    """The outcome of a pair."""

    OK = "ok"
    NOTHING_BELIEVABLE = "nothing_believable"
    NO_CORRESPONDENCES = "no_correspondences"
    FAILED = "failed"


@dataclass(frozen=True)
class PairResult:
    """All that is known about one pair of scans; `source` and `target` index the scan list."""

    source: int
    target: int
    status: PairStatus
    candidates: tuple[PoseCandidate, ...]
    reason: str | None = None
