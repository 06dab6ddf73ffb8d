"""Values that travel between the stages: scans, features, candidates, results.

Conventions: metres and radians; OpenCV camera axes (x right, y down, z forward);
``target_T_source`` maps source points into the target frame; ``world_T_scan`` is camera-to-world.
Poses are (4, 4) float64 arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FloatArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion; pixel centres at integer coordinates."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def matrix(self) -> Array:
        """The (3, 3) calibration matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Intrinsics:
        """The same camera with its image resampled to ``width`` x ``height`` pixels."""
        sx, sy = width / self.width, height / self.height
        return Intrinsics(
            width,
            height,
            self.fx * sx,
            self.fy * sy,
            (self.cx + 0.5) * sx - 0.5,
            (self.cy + 0.5) * sy - 0.5,
        )

    def quarter_turned(self) -> Intrinsics:
        """The camera of the image turned counter-clockwise by 90 degrees."""
        return Intrinsics(
            self.height, self.width, self.fy, self.fx, self.cy, self.width - 1 - self.cx
        )


@dataclass(frozen=True)
class Frame:
    """The pixels of one scan, colour and depth seen by one camera.

    Attributes:
        colour: (H, W, 3) uint8, RGB.
        depth: (H, W) float32, metres along z; 0 where nothing was measured.
        intrinsics: the camera of both images.
    """

    colour: NDArray[np.uint8]
    depth: FloatArray
    intrinsics: Intrinsics


class FrameSource(Protocol):
    """Where the pixels of a scan come from; they are read when asked for, not before."""

    def load(self) -> Frame:
        """Read the pixels.

        Raises:
            ScanError: a file is missing, corrupt, empty or of the wrong type or size.
        """


@dataclass(frozen=True)
class Scan:
    """One RGB-D scan: a name, a camera, and pixels that are loaded on demand."""

    name: str
    intrinsics: Intrinsics
    source: FrameSource

    def load(self) -> Frame:
        """Read the pixels (see `FrameSource.load`)."""
        return self.source.load()


@dataclass(frozen=True)
class ScanSet:
    """What a reader recognised in a folder. Ground-truth poses are deliberately not part of it.

    Attributes:
        format: the layout's name, for example ``"7scenes"``.
        scans: in the order of their names.
        depth_unit_m: metres per raw depth value.
        notes: what was assumed or looked odd, one line each.
    """

    format: str
    scans: tuple[Scan, ...]
    depth_unit_m: float
    notes: tuple[str, ...] = ()


class Representation(StrEnum):
    """The representations in which support for a pose is counted in the report."""

    PANORAMA = "panorama"
    LAYOUT = "layout"
    PLANES = "planes"
    KEYPOINTS = "keypoints"


@dataclass(frozen=True)
class FeatureSet:
    """Features of one kind of one scan: the paper's f = {p_f, n_f, d_f} (Sec. 3.2).

    Attributes:
        kind: which extractor made them; only features of one kind are matched with each other.
        representation: where their support is counted.
        positions: (n, 3) float64 in the scan's frame, metres.
        normals: (n, 3) float64 unit vectors in the scan's frame, towards the camera; zero where
            unknown.
        descriptors: (n, d) float32.
        observed: (n,) bool; False where the feature was predicted, not seen.
        confidence: (n,) float32 in 0..1.
        pixels: (n, 2) float32 x, y in the image for features that have one, else None.
    """

    kind: str
    representation: Representation
    positions: Array
    normals: Array
    descriptors: FloatArray
    observed: BoolArray
    confidence: FloatArray
    pixels: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True)
class PlanarPatch:
    """A planar piece of a scan found by RANSAC and PCA (Sec. 3.2, supplementary).

    Attributes:
        centre: (3,) centroid of its points, metres.
        normal: (3,) unit, towards the camera.
        extent: (2,) metres, standard deviation along the two in-plane principal axes.
        count: number of surface points on it.
    """

    centre: Array
    normal: Array
    extent: Array
    count: int


@dataclass(frozen=True)
class Levelling:
    """How a scan stands in its room.

    Attributes:
        level_R_scan: (3, 3) rotation into a frame whose z axis points up; when `manhattan`,
            its x and y axes run along the walls.
        up_confidence: 0..1, how much of the surface agrees with this up direction.
        manhattan: whether walls in two perpendicular directions were found.
        floor_z: height of the floor in the level frame (camera at 0), or None when unseen.
    """

    level_R_scan: Array
    up_confidence: float
    manhattan: bool
    floor_z: float | None


@dataclass(frozen=True)
class Surface:
    """The seen surface of a scan, thinned to one point a voxel.

    Attributes:
        points: (n, 3) float64, scan frame, metres.
        normals: (n, 3) float64 unit, towards the camera.
        colours: (n, 3) float32 CIE Lab.
        labels: (n,) int64 index into `CompletedScan.patches`, -1 where not on a patch.
    """

    points: Array
    normals: Array
    colours: FloatArray
    labels: IntArray


@dataclass(frozen=True)
class CompletedScan:
    """Everything the pair stages know of one scan.

    Attributes:
        name: the scan's name.
        image_size: width and height of the frame, the image that feature pixels refer to.
        quarter_turns: counter-clockwise turns by 90 degrees that bring the image upright.
        intrinsics: camera of `depth`.
        depth: (h, w) float32 reduced depth image for visibility checks, metres, 0 unknown.
        surface: thinned visible surface.
        patches: planar patches of the surface.
        levelling: up direction and Manhattan frame.
        features: one FeatureSet per kind.
    """

    name: str
    image_size: tuple[int, int]
    quarter_turns: int
    intrinsics: Intrinsics
    depth: FloatArray
    surface: Surface
    patches: tuple[PlanarPatch, ...]
    levelling: Levelling
    features: Mapping[str, FeatureSet]


@dataclass(frozen=True)
class Scales:
    """How precise one kind of feature is: gamma_2 to gamma_5 of the supplementary.

    gamma_1 belongs to the descriptor and has done its work in `Correspondences.similarity`.

    Attributes:
        length_m: gamma_2, metres.
        normal_angle: gamma_3, radians; direction_angle: gamma_4 and gamma_5, radians.
        normal_weight: what its normals count against its positions in the rigid fit, square metres.
        fixed_point: False where a position may shift along the surface, as a patch's centre does.
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
    """Which step proposed a candidate pose."""

    SPECTRAL = "spectral"
    MANHATTAN = "manhattan"


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
        rank: 0 for the most probable.
        target_T_source: (4, 4).
        score: spectral score of its correspondence set.
        probability: calibrated 0..1 that it is within 15 degrees and 0.3 m of the truth.
        covariance: (6, 6) of xi in target_T_source @ exp(xi), rotation (rad) before translation
            (m): the order of GTSAM's Pose3.
        matches: agreeing correspondences, (m, 2) indices per feature kind.
    """

    rank: int
    target_T_source: Array
    origin: CandidateOrigin
    score: float
    probability: float
    evidence: Evidence
    covariance: Array
    matches: Mapping[str, IntArray] = field(default_factory=dict)


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


@dataclass(frozen=True)
class EdgeReport:
    """A selected candidate in the pose graph: its robust weight and its error (m, rad), before
    (graph initialised from the discrete stage) and after optimisation."""

    source: int
    target: int
    rank: int
    weight: float
    before_m: float
    after_m: float
    before_rad: float
    after_rad: float


@dataclass(frozen=True)
class ScanPlacement:
    """Where a scan ended up; without a pose it was not placed, and `reason` says why."""

    name: str
    component: int | None
    world_T_scan: Array | None
    probability: float
    reason: str | None

    @property
    def placed(self) -> bool:
        return self.world_T_scan is not None


@dataclass(frozen=True)
class Component:
    """A set of scans that share one world frame.

    Attributes:
        scans: their indices, ascending.
        world: ``"floor"`` (z up, floor at z = 0) or ``"gravity"`` (first scan's position, z up).
        nearest_link: the best rejected candidate that would have joined it to another component,
            as text, or None.
    """

    scans: tuple[int, ...]
    world: str
    nearest_link: str | None = None


@dataclass(frozen=True)
class GlobalSolution:
    """The answer of the global stage.

    Attributes:
        placements: one per scan, in the order of the scans.
        components: largest first.
        selected: (source, target) -> rank of the chosen candidate; absent means none.
        initial_world_T_scan: poses before the pose graph, same gauge as the placements.
        edges: one per selected candidate.
    """

    placements: tuple[ScanPlacement, ...]
    components: tuple[Component, ...]
    selected: Mapping[tuple[int, int], int]
    initial_world_T_scan: Mapping[int, Array]
    edges: tuple[EdgeReport, ...]

    @property
    def headline(self) -> str:
        """How many scans share one world, and of how many components that is the largest."""
        count = len(self.components)
        largest = len(self.components[0].scans) if count else 0
        where = "placed" if count < 2 else f"in the largest of {count} components"
        return f"{largest} of {len(self.placements)} scans {where}"


@dataclass(frozen=True)
class ColouredMesh:
    """A triangle mesh: vertices (n, 3) float64 metres, faces (m, 3) int64, colours (n, 3) uint8."""

    vertices: Array
    faces: IntArray
    colours: NDArray[np.uint8]


@dataclass(frozen=True)
class Reconstruction:
    """The whole result of a run.

    Attributes:
        scans: what was read.
        completed: one per scan, same order.
        pairs: one per unordered pair, source < target.
        solution: poses and components.
        meshes: one per component, same order.
        timings_s: wall seconds per stage.
        seed: the run's seed.
        config_hash: fingerprint of the settings.
    """

    scans: ScanSet
    completed: tuple[CompletedScan, ...]
    pairs: tuple[PairResult, ...]
    solution: GlobalSolution
    meshes: tuple[ColouredMesh, ...]
    timings_s: Mapping[str, float]
    seed: int
    config_hash: str


class Observer(Protocol):
    """Watches a run without being able to change it: progress bars, the recording.

    Methods are called from one thread, scans and pairs in index order.
    """

    def started(self, scans: ScanSet) -> None:
        """The folder was read; nothing was computed yet."""

    def scan_completed(self, index: int, frame: Frame, completed: CompletedScan) -> None:
        """The features of one scan are known."""

    def pair_matched(self, result: PairResult) -> None:
        """One pair has its candidates."""

    def solved(self, solution: GlobalSolution) -> None:
        """The global stage has decided."""

    def mesh_fused(self, component: int, mesh: ColouredMesh) -> None:
        """The mesh of one component is done."""

    def finished(self, timings_s: Mapping[str, float]) -> None:
        """Everything is done; wall seconds per stage."""
