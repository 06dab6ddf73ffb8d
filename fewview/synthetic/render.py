"""Ray-cast, lit and textured views of a room."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import open3d as o3d

from fewview.synthetic import sensor
from fewview.synthetic.room import Room
from fewview.synthetic.sensor import View
from fewview.types import Array, FloatArray, Frame, IntArray, Intrinsics

_AMBIENT = 0.6
_FILM = 360.0
_LAMP_OFFSETS = np.array([[0.14, 0.05, 0.0], [-0.1, 0.12, -0.02], [-0.04, -0.17, 0.02]])


@dataclass(frozen=True)
class Hits:
    """What the rays of a view meet first, in row-major pixel order.

    Attributes:
        depth: (n,) float32 metres along the camera's z axis, infinite where nothing is met.
        quad: (n,) index of the quadrilateral, 0 where nothing is met.
        uv: (n, 2) float32 texture pixels.
        points: (n, 3) float32 in the world.
        normals: (n, 3) float32 unit, towards the camera.
        cosine: (n,) float32 of the angle between ray and normal.
    """

    depth: FloatArray
    quad: IntArray
    uv: FloatArray
    points: FloatArray
    normals: FloatArray
    cosine: FloatArray


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
    """Follow one ray through the centre of each pixel."""
    beams = rays(world_T_camera, intrinsics)
    return hits_of(room, beams, room.scene.cast_rays(o3d.core.Tensor(beams)))


def hits_of(room: Room, beams: FloatArray, found: Mapping[str, o3d.core.Tensor]) -> Hits:
    """What rays (n, 6) meet, of the ray caster's answer."""
    depth = found["t_hit"].numpy()
    met = np.isfinite(depth)
    triangle = np.where(met, found["primitive_ids"].numpy(), 0).astype(np.int64)
    normals = found["primitive_normals"].numpy()
    directions = beams[:, 3:]
    facing = np.einsum("ij,ij->i", normals, directions)
    normals *= -np.where(facing < 0, np.float32(-1), np.float32(1))[:, None]
    return Hits(
        depth=depth,
        quad=triangle // 2,
        uv=_uv_at(room, triangle, found["primitive_uvs"].numpy()),
        points=beams[:, :3] + np.where(met, depth, 0).astype(np.float32)[:, None] * directions,
        normals=normals,
        cosine=np.abs(facing) / np.sqrt(np.einsum("ij,ij->i", directions, directions)),
    )


def _uv_at(room: Room, triangle: IntArray, barycentric: FloatArray) -> FloatArray:
    """Interpolate the corners' uv; triangles are corners 0 1 2 and 0 2 3 of each quadrilateral."""
    first = room.uv[:, 0]
    to_second = (room.uv[:, 1:3] - first[:, None]).reshape(-1, 2)
    to_third = (room.uv[:, 2:4] - first[:, None]).reshape(-1, 2)
    out = barycentric[:, :1] * to_second[triangle]
    out += barycentric[:, 1:] * to_third[triangle]
    out += first[triangle // 2]
    return out


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
    hits = trace(room, world_T_camera, intrinsics)
    shape = (intrinsics.height, intrinsics.width)
    texel = room.texel_m[hits.quad]
    footprint = hits.depth / (intrinsics.fx * texel * np.sqrt(np.maximum(hits.cosine, 0.05)))
    albedo = room.atlas.lookup(room.texture[hits.quad], hits.uv, footprint.astype(np.float32))
    light = _light(room, hits, shape)
    colour = cv2.GaussianBlur((albedo * light[:, None]).reshape(*shape, 3), (0, 0), 0.6)
    colour = _FILM * (1 - np.exp(colour / -np.float32(_FILM)))
    depth = np.where(np.isfinite(hits.depth), hits.depth, 0).astype(np.float32).reshape(shape)
    view = View(colour, depth, hits.cosine.reshape(shape))
    if rng is None:
        return Frame(np.clip(colour, 0, 255).astype(np.uint8), depth, intrinsics)
    return Frame(sensor.photograph(view, rng), sensor.measure(view, rng), intrinsics)


def lit(room: Room, hits: Hits, focal: float) -> FloatArray:
    """Colours (n, 3) 0..255 without shadows, for small images of a focal length in pixels."""
    texel = room.texel_m[hits.quad]
    footprint = hits.depth / (focal * texel * np.sqrt(np.maximum(hits.cosine, 0.05)))
    albedo = room.coarse_atlas.lookup(
        room.texture[hits.quad], hits.uv, footprint.astype(np.float32)
    )
    colour = albedo * _light(room, hits, None)[:, None]
    return np.asarray(_FILM * (1 - np.exp(colour / -np.float32(_FILM))))


def _light(room: Room, hits: Hits, shape: tuple[int, int] | None) -> FloatArray:
    """(n,) light that arrives: ambient, and by Lambert's law from each lamp that is not hidden.

    Without a shape of the image nothing hides a lamp.
    """
    total = np.float32(_AMBIENT) * (1 + np.float32(0.2) * np.abs(hits.normals[:, 2]))
    strength = np.float32(1.1 / np.sqrt(len(room.lamps)))
    for lamp in room.lamps:
        way = lamp.astype(np.float32) - hits.points
        square = np.einsum("ij,ij->i", way, way)
        cosine = np.einsum("ij,ij->i", way, hits.normals) / np.sqrt(square)
        falloff = strength / (np.float32(0.45) + square / 6)
        light = np.maximum(cosine, 0) * falloff
        total += light if shape is None else light * _visibility(room, hits, lamp, shape)
    return total


def _visibility(room: Room, hits: Hits, lamp: Array, shape: tuple[int, int]) -> FloatArray:
    """(n,) share 0..1 of an extended lamp that is seen, found at half resolution and smoothed."""
    half = np.arange(shape[0] * shape[1]).reshape(shape)[::2, ::2]
    start = (hits.points + np.float32(0.006) * hits.normals)[half.ravel()]
    seen = np.zeros(half.size, np.float32)
    for offset in _LAMP_OFFSETS:
        way = (lamp + offset).astype(np.float32) - start
        beams = o3d.core.Tensor(np.concatenate([start, way], axis=1))
        seen += ~room.scene.test_occlusions(beams, tnear=0.0, tfar=1.0).numpy()
    soft = cv2.GaussianBlur((seen / len(_LAMP_OFFSETS)).reshape(half.shape), (0, 0), 2.0)
    return np.asarray(cv2.resize(soft, shape[::-1], interpolation=cv2.INTER_LINEAR)).ravel()
