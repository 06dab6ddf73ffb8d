"""Ray-cast, lit and textured views of a room."""

from __future__ import annotations

import cv2
import numpy as np

from fewview.synthetic import sensor
from fewview.synthetic.hits import Hits, hits
from fewview.synthetic.lighting import arriving, exposed, seen_from
from fewview.synthetic.room import Room
from fewview.synthetic.sensor import View
from fewview.types import Array, FloatArray, Frame, Intrinsics

_LAMP_OFFSETS = np.array([[0.14, 0.05, 0.0], [-0.1, 0.12, -0.02], [-0.04, -0.17, 0.02]])


def rays(world_T_camera: Array, intrinsics: Intrinsics) -> FloatArray:
    """(H * W, 6) origins and directions in the world; directions have length 1 along z."""
    v, u = np.indices((intrinsics.height, intrinsics.width), dtype=np.float32)
    x = (u.ravel() - np.float32(intrinsics.cx)) / np.float32(intrinsics.fx)
    y = (v.ravel() - np.float32(intrinsics.cy)) / np.float32(intrinsics.fy)
    out = np.empty((len(x), 6), np.float32)
    out[:, :3] = world_T_camera[:3, 3]
    across, down, ahead = world_T_camera[:3, :3].T.astype(np.float32)
    out[:, 3:] = x[:, None] * across + y[:, None] * down + ahead
    return out


def trace(room: Room, world_T_camera: Array, intrinsics: Intrinsics) -> Hits:
    """Follow one ray through the centre of each pixel; depth is along the camera's z axis."""
    return hits(room, room.caster, rays(world_T_camera, intrinsics))


def render(
    room: Room,
    world_T_camera: Array,
    intrinsics: Intrinsics,
    rng: np.random.Generator | None = None,
) -> Frame:
    """One RGB-D frame of a room.

    Args:
        room: what to look at.
        world_T_camera: (4, 4), OpenCV axes.
        intrinsics: of the camera.
        rng: source of the noise of colour and depth; without it the frame is free of noise,
            unbounded in range and not rounded.
    """
    met = trace(room, world_T_camera, intrinsics)
    shape = (intrinsics.height, intrinsics.width)
    texel = room.texel_m[met.quad]
    footprint = met.depth / (intrinsics.fx * texel * np.sqrt(np.maximum(met.cosine, 0.05)))
    albedo = room.atlas.lookup(room.texture[met.quad], met.uv, footprint.astype(np.float32))
    light = arriving(room, met, lambda lamp: _soft_shadow(room, met, lamp, shape))
    colour = cv2.GaussianBlur((albedo * light[:, None]).reshape(*shape, 3), (0, 0), 0.6)
    depth = np.where(np.isfinite(met.depth), met.depth, 0).astype(np.float32).reshape(shape)
    view = View(exposed(colour), depth, met.cosine.reshape(shape))
    if rng is None:
        return Frame(np.clip(view.colour, 0, 255).astype(np.uint8), depth, intrinsics)
    return Frame(sensor.photograph(view, rng), sensor.measure(view, rng), intrinsics)


def _soft_shadow(room: Room, met: Hits, lamp: Array, shape: tuple[int, int]) -> FloatArray:
    """(n,) share 0..1 of an extended lamp that is seen, found at half resolution and smoothed."""
    half = np.arange(shape[0] * shape[1]).reshape(shape)[::2, ::2]
    seen = [seen_from(room.caster, lamp + offset, met, half.ravel()) for offset in _LAMP_OFFSETS]
    share = np.mean(seen, axis=0).reshape(half.shape)
    soft = cv2.GaussianBlur(share, (0, 0), 2.0)
    return np.asarray(cv2.resize(soft, shape[::-1], interpolation=cv2.INTER_LINEAR)).ravel()
