"""The points of one training view as the relation network is given them, with the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fewview.completion.panorama.complete import complete_ring
from fewview.completion.panorama.network import PanoramaNetwork
from fewview.completion.panorama.ring import ring_pixels, ring_points, ring_rays
from fewview.completion.panorama.walls import seen_normals
from fewview.geometry import se3
from fewview.refinement.relation_points import OUTSIDE, drawn, pixel_area, predicted_pixels
from fewview.types import BoolArray, FloatArray, IntArray, RingScan

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample

SEEN, PREDICTED = 1536, 512
"""Points that are kept of a view, the seen ones first."""
AGREEMENT = 0.9
"""Least length of the mean of normals that agree."""


def view_points(
    room: RoomSample,
    turned: RoomSample,
    view: int,
    network: PanoramaNetwork,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    """The arrays of one view. What was measured and the truth come from the ring as it was made,
    since turning a ring along the walls moves its pixels, and only the completion from the other.
    """
    depth, size = turned.measured[view], turned.measured.shape[1]
    ring = RingScan(turned.colour[view] * (depth > 0)[..., None], depth, np.eye(4))
    completed = complete_ring(ring, network)
    wall_T_level = turned.level_T_world[view] @ se3.inverse(room.level_T_world[view])
    wall_R_level = wall_T_level[:3, :3].astype(np.float32)
    points, normals = ring_points(room.measured[view]), seen_normals(room.measured[view])
    area = np.where(unmixed(normals), pixel_area(points, normals), 0.0)
    shown = drawn(area, SEEN, rng)
    further = predicted_pixels(completed, PREDICTED if len(shown) else 0, rng)
    (shown, seen), (further, foreseen) = _filled(shown, SEEN), _filled(further, PREDICTED)
    place = _flat(points)[shown] @ wall_R_level.T
    pixel, _, inside = ring_pixels(place, size)
    behind, _, covered = ring_pixels(ring_rays(size) @ wall_R_level, size)
    truth = np.concatenate([shown, behind.ravel()[further]])
    there = np.concatenate([seen, foreseen & covered.ravel()[further]])
    return {
        "points": np.concatenate([place, _flat(ring_points(completed.depth))[further]]),
        "normals": np.concatenate(
            [_flat(normals)[shown] @ wall_R_level.T, _flat(completed.normals)[further]]
        ),
        "colours": _flat(room.colour[view])[truth] * (np.arange(len(truth)) < SEEN)[:, None],
        "confidence": np.append(np.ones(SEEN, np.float32), completed.confidence.ravel()[further]),
        "predicted": np.arange(len(truth)) >= SEEN,
        "valid": np.concatenate([seen, foreseen]),
        "pixels": np.append(np.where(inside, pixel, OUTSIDE), further).astype(np.int32),
        "true_points": _flat(ring_points(room.depth[view]))[truth] @ wall_R_level.T,
        "true_normals": _flat(room.normal[view])[truth] @ wall_R_level.T * there[:, None],
        "semantics": room.semantics[view].ravel()[truth] * there,
        "ring_colour": ring.colour,
        "ring_depth": ring.depth,
    }


def unmixed(normals: FloatArray) -> BoolArray:
    """(S, 4 S) where the normals (S, 4 S, 3) of a pixel and of those around it agree.

    At edges a ring's normals are mixed of two surfaces. Those of a scan's surface come from a finer
    image and hardly are; what is left here is about as far off as they are (three quarters within
    5 degrees).
    """
    known = np.linalg.norm(normals, axis=-1) > 0.5
    mode = ("nearest", "wrap", "nearest")
    mean = np.linalg.norm(ndimage.uniform_filter(normals, (3, 3, 1), mode=mode), axis=-1)
    share = ndimage.uniform_filter(known.astype(np.float32), 3, mode=mode[:2])
    return np.asarray(known & (mean > AGREEMENT * share))


def _flat(image: NDArray[Any]) -> NDArray[Any]:
    """(S, 4 S, C) to (4 S S, C)."""
    return image.reshape(-1, image.shape[-1])


def _filled(pixels: IntArray, count: int) -> tuple[IntArray, BoolArray]:
    """``count`` pixels and which of them there are: all or none."""
    if len(pixels) == count:
        return pixels, np.ones(count, bool)
    return np.zeros(count, np.int64), np.zeros(count, bool)
