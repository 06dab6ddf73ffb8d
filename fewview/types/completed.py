"""What one scan says: its features, its surface, and the room around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from fewview.types.arrays import Array, BoolArray, FloatArray, IntArray
from fewview.types.rooms import CompletedRoom
from fewview.types.scans import Intrinsics


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
        room: the room around it as the networks complete it, without dense descriptors: the
            features have taken what they need of them.
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
    room: CompletedRoom
    features: Mapping[str, FeatureSet]
