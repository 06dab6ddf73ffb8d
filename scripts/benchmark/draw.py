"""Pictures of answers beside the truth: pairs at a slant, frame sets from above."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from benchmark.page import GAP_PX, TEXT_COLOUR, Rgb, captioned, framed, message
from benchmark.rendering import (
    Picture,
    View,
    cloud_image,
    faded,
    oblique_view,
    top_view,
    upright,
)
from fewview.evaluation.gauge import absolute_errors, align
from fewview.evaluation.metrics import rotation_error_deg, translation_error_m, within
from fewview.geometry import camera, se3
from fewview.types import Array, BoolArray, FloatArray, Frame

SIZE = (480, 360)
"""Width and height of a panel without its caption."""
SAMPLES = 2
"""Pictures are drawn this many times larger and reduced."""
PAIR_ACROSS, SET_ACROSS = 400, 320
"""Points along a row of a frame."""
SMOOTH_PX = 7

TRUTH = "ground truth"
SOURCE_COLOUR, TARGET_COLOUR = (230, 159, 0), (0, 114, 178)
WRONG_COLOUR = (190, 76, 0)
TINT, DARKEST = 0.5, 60
"""Share of the tint, and how dark black becomes before it."""
OUTSIDE = 0.05
"""A panel says so when it shows less than this share of the source."""

SYMBOL = 0.3 * np.array(
    [[0, 0, 0], [-0.6, -0.45, 1], [0.6, -0.45, 1], [0.6, 0.45, 1], [-0.6, 0.45, 1], [0, 0, 1.9]]
)
"""A camera: its centre, the corners of its image, and a point that it looks at."""
SYMBOL_EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1), (0, 5))


@dataclass(frozen=True)
class Cloud:
    """Coloured points with the camera that saw them.

    Attributes:
        points: (n, 3) metres.
        normals: (n, 3) unit, towards the camera.
        colours: (n, 3) uint8.
        world_T_camera: (4, 4).
    """

    points: Array
    normals: Array
    colours: Picture
    world_T_camera: Array

    def moved(self, b_T_a: Array) -> Cloud:
        """The cloud in another frame."""
        points, normals = se3.transform(b_T_a, self.points), se3.rotate(b_T_a, self.normals)
        return Cloud(points, normals, self.colours, b_T_a @ self.world_T_camera)

    def tinted(self, colour: Rgb, share: float = TINT) -> Cloud:
        """The cloud in shades of one colour."""
        grey = self.colours @ np.array([0.299, 0.587, 0.114])
        lifted = DARKEST + grey * (1 - DARKEST / 255)
        tinted = faded(np.rint(lifted)[:, None].repeat(3, axis=1).astype(np.uint8), share, colour)
        return Cloud(self.points, self.normals, tinted, self.world_T_camera)


def frame_cloud(frame: Frame, across: int = PAIR_ACROSS) -> Cloud:
    """The measured points of a frame in its camera's frame, about ``across`` of them in a row.

    Pixels beside jumps in depth are left out: they hang between two surfaces.
    """
    grid = camera.backproject(frame.depth, frame.intrinsics)
    measured = frame.depth > 0
    normals = _normals(grid, measured)
    step = max(1, round(frame.depth.shape[1] / across))
    kept = np.zeros_like(measured)
    kept[::step, ::step] = (measured & ~camera.depth_edges(frame.depth))[::step, ::step]
    kept &= np.any(normals != 0, axis=-1)
    size = frame.depth.shape[::-1]
    colour = cv2.resize(frame.colour, size, interpolation=cv2.INTER_AREA)
    return Cloud(grid[kept].astype(np.float64), normals[kept], colour[kept], np.eye(4))


def _normals(grid: FloatArray, measured: BoolArray) -> Array:
    """Unit normals (H, W, 3) towards the camera of smoothed points (H, W, 3); 0 where unknown."""
    share = cv2.blur(measured.astype(np.float32), (SMOOTH_PX, SMOOTH_PX))[..., None]
    blurred = cv2.blur(grid, (SMOOTH_PX, SMOOTH_PX))
    smooth = (blurred / np.maximum(share, 1e-6)).astype(np.float64)
    normals = np.cross(np.gradient(smooth, axis=0), np.gradient(smooth, axis=1))
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    away = np.einsum("ijk,ijk->ij", normals, grid) > 0
    return np.asarray(np.where(away[..., None], -normals, normals))


def pair_row(
    source: Frame,
    target: Frame,
    poses: Mapping[str, Array | None],
    truth: Array,
    up: Array | None = None,
    size: tuple[int, int] = SIZE,
) -> dict[str, Picture]:
    """The two frames, how they truly lie, and how each method lays them, by column title.

    All from one camera, chosen from the truth. In the methods' panels the source is orange and the
    target blue; the caption is the rotation error and the error of the source camera's centre.

    Args:
        source: the frame that a pose moves.
        target: the frame in whose camera frame all is drawn.
        poses: target_T_source (4, 4) of each method, None for no answer.
        truth: the true target_T_source.
        up: (3,) unit in the target's frame; by default from horizontal surfaces and image rows.
        size: of a panel, without its caption.
    """
    moving, still = frame_cloud(source), frame_cloud(target)
    true = (still, moving.moved(truth))
    up = _up(true) if up is None else up
    view = oblique_view(*_surface(true), up, size, _symbols(true))
    row = {"scans": _photographs(source, target, size[1]), TRUTH: _panel(true, view, _PAIR_COLOURS)}
    for name, pose in poses.items():
        if pose is None:
            row[name] = message("no answer", size)
            continue
        clouds = (still.tinted(TARGET_COLOUR), moving.tinted(SOURCE_COLOUR).moved(pose))
        caption, colour = pair_caption(truth, pose)
        note = "" if _shown(view, clouds[1]) > OUTSIDE else ", source outside"
        row[name] = _panel(clouds, view, _PAIR_COLOURS, caption + note, colour)
    return row


def set_row(
    frames: Sequence[Frame],
    poses: Mapping[str, Sequence[Array | None]],
    truth: Sequence[Array],
    up: Array | None = None,
    size: tuple[int, int] = SIZE,
) -> dict[str, Picture]:
    """A set of frames from above, as it is and as each method lays it out, by column title.

    Every scan has a colour, and a symbol where its camera stands and looks. Methods' scans are
    drawn after the gauge alignment over the scans that they placed; the others are counted.

    Args:
        frames: n scans.
        poses: n world_T_scan of one component of each method, None for scans not part of it.
        truth: n true world_T_scan.
        up: (3,) unit in the true world; by default from horizontal surfaces and image rows.
        size: of a panel, without its caption.
    """
    colours = [_scan_colour(i) for i in range(len(frames))]
    clouds = [frame_cloud(f, SET_ACROSS).tinted(c) for f, c in zip(frames, colours, strict=True)]
    true = [cloud.moved(pose) for cloud, pose in zip(clouds, truth, strict=True)]
    up = _up(true) if up is None else up
    view = top_view(*_surface(true), up, size, _symbols(true))
    row = {TRUTH: _panel(true, view, colours, f"{len(frames)} scans")}
    for name, estimate in poses.items():
        placed = [i for i, pose in enumerate(estimate) if pose is not None]
        if len(placed) < 2:
            row[name] = message("no answer", size, f"{len(frames)} unplaced")
            continue
        found = np.stack([pose for pose in estimate if pose is not None])
        aligned = align(np.stack([truth[i] for i in placed]), found) @ found
        drawn = [clouds[i].moved(pose) for i, pose in zip(placed, aligned, strict=True)]
        caption = set_caption(np.stack(truth), estimate)
        row[name] = _panel(drawn, view, [colours[i] for i in placed], caption)
    return row


_PAIR_COLOURS = (TARGET_COLOUR, SOURCE_COLOUR)


def _panel(
    clouds: Sequence[Cloud],
    view: View,
    colours: Sequence[Rgb],
    caption: str = "",
    caption_colour: Rgb = TEXT_COLOUR,
) -> Picture:
    """Clouds and their cameras, each symbol in its colour, over a line of text."""
    large = view.enlarged(SAMPLES)
    points, normals = _surface(clouds)
    shades = np.concatenate([cloud.colours for cloud in clouds])
    picture = cloud_image(points, shades, large, normals, radius=SAMPLES // 2)
    for cloud, colour in zip(clouds, colours, strict=True):
        _draw_camera(picture, large, cloud.world_T_camera, colour)
    reduced = cv2.resize(picture, view.size, interpolation=cv2.INTER_AREA)
    return captioned(reduced.astype(np.uint8), caption, caption_colour)


def _draw_camera(picture: Picture, view: View, pose: Array, colour: Rgb) -> None:
    corners = np.rint(view.project(se3.transform(pose, SYMBOL))[:, :2]).astype(int).tolist()
    for stroke, width in (((255, 255, 255), 5 * SAMPLES), (colour, 2 * SAMPLES)):
        for a, b in SYMBOL_EDGES:
            cv2.line(picture, corners[a], corners[b], stroke, width, cv2.LINE_AA)


def _photographs(source: Frame, target: Frame, height: int) -> Picture:
    """Both colour images above each other, framed in their colours."""
    half = (height - GAP_PX) // 2
    photographs = [
        framed(frame.colour, half, colour)
        for frame, colour in ((source, SOURCE_COLOUR), (target, TARGET_COLOUR))
    ]
    out = np.full((height, max(p.shape[1] for p in photographs), 3), 255, np.uint8)
    for photograph, y in zip(photographs, (0, height - half), strict=True):
        x = (out.shape[1] - photograph.shape[1]) // 2
        out[y : y + half, x : x + photograph.shape[1]] = photograph
    return captioned(out, "source, target")


def pair_caption(truth: Array, pose: Array) -> tuple[str, Rgb]:
    """Errors of a target_T_source and whether it is right, and the colour to say so in."""
    rotation, translation = rotation_error_deg(truth, pose), translation_error_m(truth, pose)
    errors = f"{rotation:.1f}°, {translation:.2f} m"
    right = bool(within(rotation, translation))
    return (f"✓ {errors}", TEXT_COLOUR) if right else (f"✗ {errors}", WRONG_COLOUR)


def set_caption(truth: Array, estimate: Sequence[Array | None]) -> str:
    """How many of (n, 4, 4) scans are right by the few-view protocol, and how many unplaced."""
    errors = absolute_errors(truth, estimate)
    right = int((errors.right & errors.placed).sum())
    return f"{right} of {len(truth)} right, {int((~errors.placed).sum())} unplaced"


def _surface(clouds: Sequence[Cloud]) -> tuple[Array, Array]:
    """Points and normals of all clouds."""
    points = np.concatenate([cloud.points for cloud in clouds])
    return points, np.concatenate([cloud.normals for cloud in clouds])


def _symbols(clouds: Sequence[Cloud]) -> Array:
    """The corners (m, 3) of the symbols of all cameras."""
    return np.concatenate([se3.transform(cloud.world_T_camera, SYMBOL) for cloud in clouds])


def _shown(view: View, cloud: Cloud) -> float:
    """Share of a cloud inside the picture."""
    pixels = view.project(cloud.points)[:, :2]
    return float(np.mean(np.all((pixels >= 0) & (pixels < view.size), axis=1)))


def _up(clouds: Sequence[Cloud]) -> Array:
    rough = -np.sum([cloud.world_T_camera[:3, 1] for cloud in clouds], axis=0)
    return upright(np.concatenate([cloud.normals for cloud in clouds]), rough)


def _scan_colour(index: int) -> Rgb:
    """Colours far apart, however many: hues in steps of the golden section."""
    hue, value = (0.58 + 0.618034 * index) % 1.0, (0.95, 0.7)[index % 2]
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(hue, 0.85, value))
    return red, green, blue
