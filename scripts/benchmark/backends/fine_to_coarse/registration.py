"""Fine-to-Coarse global registration of RGB-D scans (Halber and Funkhouser, CVPR 2017).

Twelve times: look for closest points between frames within a window of the trajectory, cluster
the frames' planes within it into structures, relate these, and solve for poses and structures at
once; then double the window, which starts at 3 m. Weights, tolerances and their course are the
defaults of the authors' program, `fetregister`; where not, it is said beside them.

Simplified: closest points are point-to-plane alone (the program also pairs creases and
silhouettes), asked from the same points of a frame each time, and frames need not overlap in
their bounding boxes; a plane of a frame stands rigidly in its frame, so that points of it pull at
the structure directly; a structure needs two planes, not 2000 points, and no minimal extent; each
window is solved by three Gauss-Newton steps; the length of the trajectory is not smoothed.
Adapted to scans that are not video: the trajectory term keeps the motions that pairwise
registration gave, each in full; the program ties every frame to the next twelve of the video,
fading with 0.25 m, which together are less than one step here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmark.backends.fine_to_coarse import equations, structures
from benchmark.backends.fine_to_coarse.correspondences import closest_points
from benchmark.backends.fine_to_coarse.equations import State, Tie
from benchmark.backends.fine_to_coarse.views import View, view_of
from benchmark.methods.interface import Candidate
from fewview.geometry import se3
from fewview.types import Array, Frame

ITERATIONS = 12
GAUSS_NEWTON_STEPS = 3
WINDOW_M = 3.0
STRUCTURE_WEIGHT = (1500.0, 1000.0)
"""Of closest points, hierarchy and relations, in the first and in the last iteration."""
TRAJECTORY_WEIGHT, INERTIA = 1000.0, 1.0


def fine_to_coarse(
    frames: Sequence[Frame], local: Mapping[tuple[int, int], Candidate]
) -> list[Array]:
    """Register a sequence of frames.

    Args:
        frames: in the order in which they were taken.
        local: motions of consecutive frames by (source, target) = (i, i + 1); where one is
            missing the camera is taken to have stayed where it was, and nothing holds it there.

    Returns:
        world_T_scan (4, 4) of every frame; the first frame is the world.
    """
    views = [view_of(frame) for frame in frames]
    ties = _ties(views, local)
    poses = _concatenated(len(frames), local)
    for iteration in range(ITERATIONS):
        window_m = WINDOW_M * 2.0**iteration
        weight = float(np.interp(iteration, (0, ITERATIONS - 1), STRUCTURE_WEIGHT))
        poses = _solve(views, poses, ties, window_m, weight)
    return list(se3.inverse(poses[0]) @ poses)


def _concatenated(count: int, local: Mapping[tuple[int, int], Candidate]) -> Array:
    poses = [np.eye(4)]
    for i in range(count - 1):
        found = local.get((i, i + 1))
        poses.append(poses[-1] if found is None else poses[-1] @ se3.inverse(found.target_T_source))
    return np.stack(poses)


def _arc(poses: Array) -> Array:
    """(n,) metres travelled up to each frame."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _ties(views: Sequence[View], local: Mapping[tuple[int, int], Candidate]) -> list[Tie]:
    """The motions that pairwise registration gave, to be kept."""
    steps = [(i, i + 1) for i in range(len(views) - 1) if (i, i + 1) in local]
    return [Tie(a, b, se3.inverse(local[a, b].target_T_source), views[b].radius) for a, b in steps]


def _solve(
    views: Sequence[View], poses: Array, ties: Sequence[Tie], window_m: float, weight: float
) -> Array:
    """Poses after the constraints of one window length were found and enforced."""
    arc = _arc(poses)
    planes, owner = structures.cluster(structures.planes_of(views, poses, arc), window_m)
    relations = structures.relations(planes, window_m)
    pairs = closest_points(views, poses, arc, window_m)
    members = np.concatenate([view.members for view in views])[owner >= 0]
    frames = np.repeat(np.arange(len(views)), [len(view.members) for view in views])[owner >= 0]
    repeats = members.shape[1]
    on = np.repeat(frames, repeats), members.reshape(-1, 3), np.repeat(owner[owner >= 0], repeats)
    state = State(poses, planes.centres, planes.normals, np.zeros(len(planes.counts)))
    for _ in range(GAUSS_NEWTON_STEPS):
        terms = (
            equations.point_to_plane(state, pairs, weight),
            equations.point_on_structure(state, *on, weight),
            equations.related(state, relations, weight),
            equations.tied(state, ties, TRAJECTORY_WEIGHT),
        )
        unknowns = 6 * len(poses) + 3 * len(planes.counts)
        state = state.moved(equations.step(terms, unknowns, INERTIA))
    return state.poses
