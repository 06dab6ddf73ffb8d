"""Following rays with torch alone, for machines with an accelerator and without Open3D."""

from __future__ import annotations

import numpy as np
import torch

from fewview.synthetic.rays import TRIANGLES, Met
from fewview.types import Array, BoolArray, FloatArray

_PAIRS = {"cpu": 2**20, "cuda": 2**25}
_BEYOND = 1e-5
_FLAT_M2 = 1e-12


class TorchCaster:
    """Tests every ray against every triangle, many at a time.

    A triangle's own frame has its first corner at the origin, its edges to the second and third as
    x and y axes and its unit normal as z axis: a ray meets its plane where z is 0, inside where
    x >= 0, y >= 0 and x + y <= 1 (Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection",
    2013, and Woop's diploma thesis, 2004).
    """

    def __init__(self, corners: Array, device: str = "cpu") -> None:
        """Take quadrilaterals (n, 4, 3) to a device."""
        triangles = corners[:, TRIANGLES].reshape(-1, 3, 3)
        edges = triangles[:, 1:] - triangles[:, :1]
        normal = np.cross(edges[:, 0], edges[:, 1])
        size = np.linalg.norm(normal, axis=-1, keepdims=True)
        self._numbers = np.flatnonzero(size[:, 0] > _FLAT_M2)
        solid = self._numbers
        axes = np.stack([edges[:, 0], edges[:, 1], normal / np.maximum(size, _FLAT_M2)], axis=-1)
        self._middle = corners.reshape(-1, 3).mean(axis=0)
        turn = np.linalg.inv(axes[solid])
        shift = -(turn @ (triangles[solid, 0] - self._middle)[..., None])[..., 0]
        self._device = torch.device(device)
        self._turn = torch.tensor(turn, dtype=torch.float32, device=device).permute(1, 2, 0)
        self._shift = torch.tensor(shift, dtype=torch.float32, device=device).T[:, None]

    def cast(self, beams: FloatArray) -> Met:
        """The first hits of rays (n, 6), origins and directions."""
        found = [self._first(part) for part in self._parts(beams)]
        depth, number, weights = (
            torch.cat(part).cpu().numpy() for part in zip(*found, strict=True)
        )
        triangle = np.where(np.isfinite(depth), self._numbers[number], 0)
        return Met(depth, triangle, weights)

    def blocked(self, beams: FloatArray) -> BoolArray:
        """(n,) whether something is between 0 and 1 lengths along rays (n, 6)."""
        near = [(self._distances(part)[0] < 1.0).any(dim=1) for part in self._parts(beams)]
        return np.asarray(torch.cat(near).cpu().numpy())

    def _parts(self, beams: FloatArray) -> tuple[torch.Tensor, ...]:
        local = beams.copy()
        local[:, :3] -= self._middle.astype(np.float32)
        rows = max(1, _PAIRS.get(self._device.type, 2**22) // len(self._numbers))
        return torch.split(torch.from_numpy(local).to(self._device), rows)

    def _distances(self, beams: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """(n, triangles) lengths to each triangle, infinite where missed, and where on it."""
        x0, y0, z0 = (beams[:, :3] @ self._turn[i] + self._shift[i] for i in range(3))
        dx, dy, dz = (beams[:, 3:] @ self._turn[i] for i in range(3))
        length = -z0 / dz
        x, y = dx.mul_(length).add_(x0), dy.mul_(length).add_(y0)
        inside = (x >= -_BEYOND) & (y >= -_BEYOND) & (x + y <= 1 + _BEYOND) & (length > 0)
        return length.masked_fill_(~inside, torch.inf), x, y

    def _first(self, beams: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        length, x, y = self._distances(beams)
        depth, number = length.min(dim=1)
        weights = torch.cat([x.gather(1, number[:, None]), y.gather(1, number[:, None])], dim=1)
        return depth, number, weights
