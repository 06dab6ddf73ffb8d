"""Models of thousands of triangles brought down to hundreds, as quadrilaterals."""

from __future__ import annotations

import numpy as np

from fewview.types import Array, IntArray

_WELD_M = 1e-4
_ALIKE = 0.999


def single(triangles: Array, material: IntArray) -> tuple[Array, IntArray]:
    """Leave out what is flat or there twice, as a back of the same corners.

    Args:
        triangles: (n, 3, 3) corners, metres.
        material: (n,) of each.
    """
    solid = np.flatnonzero(_areas(triangles) > _WELD_M**2)
    corners = np.sort(_welded(triangles[solid]), axis=1)
    places = np.int64(corners.max(initial=0) + 1)
    _, once = np.unique(corners @ places ** np.arange(3), return_index=True)
    kept = solid[np.sort(once)]
    return triangles[kept], material[kept]


def simplified(triangles: Array, material: IntArray, budget: int) -> tuple[Array, IntArray]:
    """Collapse the edges whose loss shows least (Garland and Heckbert 1997), within materials.

    Args:
        triangles: (n, 3, 3) corners, metres.
        material: (n,) of each.
        budget: triangles that are wanted; fewer are left as they are.

    Returns:
        The corners (m, 3, 3) and materials (m,) of about as many triangles.
    """
    if len(triangles) <= budget:
        return triangles, material
    import open3d as o3d

    kinds, of_corner = material.max() + 1, np.repeat(material, 3)
    pairs = _welded(triangles).ravel() * kinds + of_corner
    _, first, faces = np.unique(pairs, return_index=True, return_inverse=True)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(triangles.reshape(-1, 3)[first]),
        o3d.utility.Vector3iVector(faces.reshape(-1, 3).astype(np.int32)),
    )
    named = np.repeat(of_corner[first, None], 3, axis=1).astype(np.float64)
    mesh.vertex_colors = o3d.utility.Vector3dVector(named)
    mesh = mesh.remove_degenerate_triangles().simplify_quadric_decimation(budget)
    corners, left = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    names = np.rint(np.asarray(mesh.vertex_colors)[:, 0]).astype(np.int64)
    return single(corners[left], names[left[:, 0]])


def _welded(triangles: Array) -> IntArray:
    """(n, 3) numbers of the places where corners meet."""
    steps = np.rint(triangles.reshape(-1, 3) / _WELD_M).astype(np.int64) + 2**20
    _, places = np.unique(steps @ (1 << np.array([42, 21, 0])), return_inverse=True)
    return np.asarray(places, np.int64).reshape(-1, 3)


def area(triangles: Array) -> float:
    """Of triangles (n, 3, 3)."""
    return float(_areas(triangles).sum())


def _areas(triangles: Array) -> Array:
    edges = triangles[:, 1:] - triangles[:, :1]
    return np.asarray(0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1))


def paired(triangles: Array, material: IntArray) -> tuple[Array, IntArray]:
    """Join neighbours of one material that make up a flat convex quadrilateral.

    Args:
        triangles: (n, 3, 3) corners, metres.
        material: (n,) of each.

    Returns:
        Corners (m, 4, 3), the last one twice where a triangle stays alone, and materials (m,).
    """
    places, names = _welded(triangles).tolist(), material.tolist()
    waiting: dict[tuple[int, int, int], tuple[int, int]] = {}
    alone = np.ones(len(triangles), bool)
    quads, owners = [], []
    for i, k in np.ndindex(len(triangles), 3):
        here, ahead, far = k, (k + 1) % 3, (k + 2) % 3
        j, beyond = waiting.get((places[i][ahead], places[i][here], names[i]), (-1, 0))
        if j >= 0 and alone[i] and alone[j]:
            quad = np.insert(triangles[i, [here, ahead, far]], 1, triangles[j, beyond], axis=0)
            if _is_flat_and_convex(quad):
                alone[[i, j]] = False
                quads.append(quad)
                owners.append(i)
        waiting[places[i][here], places[i][ahead], names[i]] = i, far
    joined = np.array(quads).reshape(-1, 4, 3)
    corners = np.concatenate([joined, triangles[alone][:, [0, 1, 2, 2]]])
    return corners, np.concatenate([material[owners], material[alone]])


def _is_flat_and_convex(quad: Array) -> bool:
    edges = np.roll(quad, -1, axis=0) - quad
    turns = np.cross(np.roll(edges, 1, axis=0), edges)
    alike = turns @ turns[0]
    lengths = np.linalg.norm(turns, axis=1)
    return bool((alike > _ALIKE * lengths * lengths[0]).all())
