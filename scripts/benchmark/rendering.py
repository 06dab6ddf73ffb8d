"""Coloured point clouds to pixels: orthographic cameras and a z-buffer of square splats.

Nothing here needs a display, and the same input gives the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fewview.geometry import se3
from fewview.types import Array, BoolArray, IntArray

Picture = NDArray[np.uint8]
"""(H, W, 3) RGB."""

BACKGROUND = (244, 246, 248)
MARGIN = 0.06
"""Of the picture's size, left empty on each side of the scene."""
FITTED_PERCENT = (1.0, 99.0)
"""The share of the points along each axis that has to be in the picture."""
EYE_M = 1000.0
"""How far an oblique view stands off; orthographic, so it only has to be outside."""

ELEVATION_DEG, AZIMUTHS = 48.0, 32
CUT_M, CUT_PERCENT, FLOOR_PERCENT = 2.0, 90.0, 2.0
"""Views from above cut the room this high over its floor, or at this percentile if lower."""

FADED = 0.65
"""Share of white in surfaces that are seen from behind."""
RIM, RIM_M = 2.5, 0.25
"""How much depth edges darken what lies behind them, per metre and up to how many metres."""
UP_CONES_DEG = (30.0, 15.0, 7.0)
"""How far from the guess, in three steps, a normal may be to count as vertical."""
LEVEL_DEG = 15.0
"""How far from level a wall's normal may be."""


@dataclass(frozen=True)
class View:
    """An orthographic camera.

    Attributes:
        camera_T_world: (4, 4), OpenCV axes; what lies behind the camera is not drawn.
        pixels_per_m: the scale.
        size: width and height in pixels; the optical axis meets the middle.
    """

    camera_T_world: Array
    pixels_per_m: float
    size: tuple[int, int]

    def project(self, points: Array) -> Array:
        """Pixel x, pixel y and depth in metres, (n, 3), of world points (n, 3)."""
        out = se3.transform(self.camera_T_world, points)
        out[:, :2] = self.pixels_per_m * out[:, :2] + (np.array(self.size) - 1) / 2
        return out

    def faces(self, normals: Array) -> BoolArray:
        """Which world normals (n, 3) point towards the camera."""
        return np.asarray(normals @ self.camera_T_world[2, :3] < 0)

    def enlarged(self, factor: int) -> View:
        """The same view with ``factor`` times as many pixels each way."""
        width, height = self.size
        return View(
            self.camera_T_world, self.pixels_per_m * factor, (width * factor, height * factor)
        )


def oblique_view(
    points: Array, normals: Array, up: Array, size: tuple[int, int], marks: Array | None = None
) -> View:
    """From above at a slant, from the side from which most surface shows its front.

    Args:
        points: (n, 3) world points; the picture holds all but outliers.
        normals: (n, 3) unit, towards the side from which a surface was seen.
        up: (3,) unit.
        size: width and height in pixels.
        marks: (m, 3) world points that the picture holds without exception, such as cameras.
    """
    east, north = _level_axes(up)
    azimuths = 2 * np.pi * np.arange(AZIMUTHS)[:, None] / AZIMUTHS
    elevation = np.radians(ELEVATION_DEG)
    level = np.cos(azimuths) * east + np.sin(azimuths) * north
    to_eye = np.cos(elevation) * level + np.sin(elevation) * up
    shown = np.maximum(normals @ to_eye.T, 0.0).sum(axis=0)
    rotation = _looking(-to_eye[int(np.argmax(shown))], up)
    return _fitted(points, rotation, size, -EYE_M, marks)


def top_view(
    points: Array, normals: Array, up: Array, size: tuple[int, int], marks: Array | None = None
) -> View:
    """From straight above, below the ceiling, walls along the picture's edges.

    The camera stands `CUT_M` over the floor or at the 90th percentile of the heights, whichever is
    lower, so that whatever is higher lies behind it. Of the two ways to lay the walls along the
    edges the one that shows the scene larger. Arguments as for `oblique_view`.
    """
    heights = points @ up
    floor, most = np.percentile(heights, [FLOOR_PERCENT, CUT_PERCENT])
    cut = min(float(floor) + CUT_M, float(most))
    below = points[heights <= cut]
    angle = _wall_angle(normals, up)
    east, north = _level_axes(up)
    quarters = angle + np.pi / 2 * np.arange(2)[:, None]
    sides = np.cos(quarters) * east + np.sin(quarters) * north
    views = [_fitted(below, _looking(-up, side), size, -cut, marks) for side in sides]
    return max(views, key=lambda view: view.pixels_per_m)


def upright(normals: Array, rough: Array) -> Array:
    """The up direction (3,): what most near-horizontal surfaces agree on.

    Args:
        normals: (n, 3) unit normals of the scene; floors, tables and ceilings among them.
        rough: (3,) a first guess within about 30 degrees.
    """
    up = rough / np.linalg.norm(rough)
    for cone in UP_CONES_DEG:
        cosine = normals @ up
        agreeing = np.abs(cosine) > np.cos(np.radians(cone))
        mean = (normals[agreeing] * np.sign(cosine[agreeing])[:, None]).sum(axis=0)
        length = float(np.linalg.norm(mean))
        up = mean / length if length > 0 else up
    return np.asarray(up)


def cloud_image(
    points: Array, colours: Picture, view: View, normals: Array | None = None, radius: int = 1
) -> Picture:
    """Draw a point cloud; the nearest point wins a pixel.

    With normals, surfaces seen from behind are faded and never hide those seen from the front, so
    one looks into a room through its near walls.

    Args:
        points: (n, 3) world points, metres.
        colours: (n, 3) uint8.
        view: the camera.
        normals: (n, 3) unit, or None.
        radius: a point covers a square of 2 * radius + 1 pixels.

    Returns:
        (H, W, 3) RGB.
    """
    projected = view.project(points)
    depth = projected[:, 2].copy()
    drawn = depth >= 0
    if normals is not None:
        behind = ~view.faces(normals)
        colours = np.where(behind[:, None], faded(colours, FADED), colours)
        depth[behind] += 2 * EYE_M
    pixels = np.rint(projected[drawn, :2]).astype(np.int64)
    nearest, distance = _z_buffer(pixels, depth[drawn], view.size, radius)
    out = np.full((*nearest.shape, 3), BACKGROUND, np.uint8)
    hit = nearest >= 0
    shade = _rims(distance)[hit, None]
    out[hit] = np.rint(colours[drawn][nearest[hit]] * shade).astype(np.uint8)
    return out


def faded(colours: Picture, share: float, into: tuple[int, int, int] = (255, 255, 255)) -> Picture:
    """Colours (..., 3) mixed with a share 0..1 of another one."""
    return np.rint((1 - share) * colours + share * np.array(into)).astype(np.uint8)


def _z_buffer(
    pixels: IntArray, depth: Array, size: tuple[int, int], radius: int
) -> tuple[IntArray, Array]:
    """Index of the nearest point at every pixel (-1 for none) and its depth (inf for none)."""
    width, height = size
    nearest, distance = np.full(width * height, -1), np.full(width * height, np.inf)
    far_first = np.argsort(-depth, kind="stable")
    or_nothing = np.append(depth, np.inf)  # where index -1 finds infinity
    for dx, dy in np.ndindex(2 * radius + 1, 2 * radius + 1):
        x, y = (pixels[far_first] + (dx - radius, dy - radius)).T
        inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        points, at = far_first[inside], (y * width + x)[inside]
        layer = np.full(width * height, -1)
        layer[at] = points  # of equal pixels the last one is kept: the nearest
        layer_depth = or_nothing[layer]
        nearer = layer_depth < distance
        nearest[nearer], distance[nearer] = layer[nearer], layer_depth[nearer]
    return nearest.reshape(height, width), distance.reshape(height, width)


def _rims(distance: Array) -> Array:
    """Factors (H, W) that darken pixels behind a nearer neighbour: eye-dome lighting.

    Boucheny, Interactive scientific visualization of large datasets (2009), with four neighbours.
    """
    finite = np.where(np.isfinite(distance), distance, 1e9)
    padded = np.pad(finite, 1, mode="edge")
    neighbours = (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:])
    drops = [np.clip(finite - other, 0.0, RIM_M) for other in neighbours]
    return np.asarray(np.exp(-RIM * np.mean(drops, axis=0)))


def _fitted(
    points: Array, rotation: Array, size: tuple[int, int], eye_z: float, marks: Array | None
) -> View:
    """The view with camera_R_world ``rotation`` that holds the points, ``eye_z`` along its axis."""
    held = np.percentile(points @ rotation.T, FITTED_PERCENT, axis=0)
    if marks is not None:
        held = np.concatenate([held, marks @ rotation.T])
    low, high = held.min(axis=0), held.max(axis=0)
    extent = np.maximum(high - low, 1e-6)[:2]
    scale = float(np.min((1 - 2 * MARGIN) * np.array(size) / extent))
    eye = np.append((low + high)[:2] / 2, eye_z)
    return View(se3.pose(rotation, -eye), scale, size)


def _wall_angle(normals: Array, up: Array) -> float:
    """Angle from the first level axis to a wall's normal, where walls stand at right angles.

    The direction, modulo a quarter turn, of the mean of exp(4 i angle) over the level normals.
    """
    level = normals[np.abs(normals @ up) < np.sin(np.radians(LEVEL_DEG))]
    east, north = _level_axes(up)
    return float(np.angle(np.sum(((level @ east) + 1j * (level @ north)) ** 4)) / 4)


def _looking(forward: Array, up: Array) -> Array:
    """camera_R_world that looks along ``forward`` with ``up`` upwards in the picture."""
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _level_axes(up: Array) -> tuple[Array, Array]:
    """Two unit vectors perpendicular to ``up`` and to each other."""
    other = np.eye(3)[int(np.argmin(np.abs(up)))]
    east = np.cross(other, up)
    east /= np.linalg.norm(east)
    return east, np.cross(up, east)
