"""The room around one scan, seen and predicted, in the three representations of Sec. 3.2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fewview.types.arrays import Array, BoolArray, FloatArray


@dataclass(frozen=True)
class RingScan:
    """What one scan shows of its surroundings, on a levelled ring of four faces of S x S pixels.

    Attributes:
        colour: (S, 4 S, 3) uint8 RGB, 0 where nothing was measured.
        depth: (S, 4 S) float32, planar, metres, 0 where nothing was measured.
        level_T_scan: (4, 4).
    """

    colour: NDArray[np.uint8]
    depth: FloatArray
    level_T_scan: Array


@dataclass(frozen=True)
class CompletedPanorama:
    """The surroundings of one scan, seen and predicted, on the levelled ring.

    Attributes:
        depth: (S, 4 S) float32, planar, metres, positive everywhere.
        normals: (S, 4 S, 3) float32 unit, in the ring's level frame, towards the camera.
        semantics: (S, 4 S, 12) float32 probabilities of `completion.panorama.CLASSES`.
        descriptors: (S, 4 S, D) float32 unit.
        confidence: (S, 4 S) float32, probability that the depth is right within ten per cent.
        observed: (S, 4 S) where the depth was measured.
        level_T_scan: (4, 4) into the ring's level frame.
    """

    depth: FloatArray
    normals: FloatArray
    semantics: FloatArray
    descriptors: FloatArray
    confidence: FloatArray
    observed: BoolArray
    level_T_scan: Array


@dataclass(frozen=True)
class CompletedLayout:
    """A room from above on a grid along its walls; see `completion.layout.grid` for its cells.

    Attributes:
        level_T_scan: (4, 4) into the grid's frame: camera at the origin, z up, +x towards row 0.
        probabilities: (5, 64, 64) float32 of the classes in `grid.CLASSES`.
        classes: (64, 64) uint8 the chosen class; see `LayoutNetwork.classes`.
        descriptors: (64, 64, 32) float32 unit.
        confidence: (64, 64) float32, probability that the chosen class is right.
        observed: (64, 64) bool, cells with a point or that the camera looked through.
        floor: (4,) normal n (upwards) and offset d of the floor n . x = d, same frame.
    """

    level_T_scan: Array
    probabilities: FloatArray
    classes: NDArray[np.uint8]
    descriptors: FloatArray
    confidence: FloatArray
    observed: BoolArray
    floor: Array

    @property
    def floor_z(self) -> float:
        """Height of the floor under the camera, which is at 0."""
        return float(self.floor[3] / self.floor[2])


@dataclass(frozen=True)
class StructuralPlane:
    """A wall, the floor or the ceiling in the level frame of the scan's ring.

    Attributes:
        kind: ``"floor"``, ``"ceiling"`` or ``"wall"``.
        centre: (3,) predicted middle of the whole plane, on it.
        normal: (3,) unit, into the room.
        descriptor: (32,) unit.
        confidence: 0..1, that there is such a plane within 0.3 m.
        observed: whether the scan shows part of it; then normal and offset are its points'.
    """

    kind: str
    centre: Array
    normal: Array
    descriptor: FloatArray
    confidence: float
    observed: bool


@dataclass(frozen=True)
class CompletedPlanes:
    """What the network says of one scan.

    Attributes:
        planes: floor, ceiling, then walls by falling confidence.
        normals: (n, 3) of the planes that the given points belong to, unit, level frame.
        centres: (n, 3) of those planes, level frame.
        semantics: (n, 12) probabilities of the classes of the 360-image network.
        descriptors: (n, 32) unit.
        confidence: (n,) that the centre is within 0.3 m.
    """

    planes: tuple[StructuralPlane, ...]
    normals: FloatArray
    centres: FloatArray
    semantics: FloatArray
    descriptors: FloatArray
    confidence: FloatArray


@dataclass(frozen=True)
class CompletedRoom:
    """The room around a scan: what it shows, and what each network that was asked makes of it.

    Attributes:
        ring: the scan itself, along the walls that it shows.
        panorama, layout, planes: the three representations, None where the network was not asked;
            in a `CompletedScan` their `descriptors` have no columns.
    """

    ring: RingScan
    panorama: CompletedPanorama | None = None
    layout: CompletedLayout | None = None
    planes: CompletedPlanes | None = None

    @property
    def completed(self) -> bool:
        """Whether any network was asked."""
        return any(part is not None for part in (self.panorama, self.layout, self.planes))

    @property
    def level_T_scan(self) -> Array:
        """(4, 4) into the level frame of ring, panorama and planes: camera at the origin, z up,
        axes along the walls that the scan shows."""
        return self.ring.level_T_scan
