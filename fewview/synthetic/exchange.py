"""Models of a library in the place of procedural furniture, in the same boxes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from fewview.synthetic.items import Patches
from fewview.synthetic.kinds import Kind
from fewview.synthetic.library import Library, Model
from fewview.synthetic.models import Shape
from fewview.synthetic.splits import split_of
from fewview.synthetic.surfaces import Part, Patch, moved
from fewview.synthetic.textures import Rng, Texture, muted, plain
from fewview.types import Array

_SHARE = 2 / 3
_SCALES = (0.6, 1.6)
_STRETCH = 1.5
_BRIGHT = 200.0


@dataclass(frozen=True)
class Exchange:
    """Exchanges the parts of pieces; those of a kind in a piece all become the same model.

    Attributes:
        models: to choose from.
        rng: chooses.
    """

    models: tuple[Model, ...]
    rng: Rng

    def __call__(self, patches: Patches) -> Patches:
        """The patches of a piece, with models for the parts of some of the kinds in it."""
        parts = dict.fromkeys(p.part for p in patches if p.part is not None)
        others: dict[Part, Patches] = {}
        for kind in dict.fromkeys(part.kind for part in parts):
            alike = [part for part in parts if part.kind is kind]
            shape = self._shape(kind, alike[0].size) if self.rng.uniform() < _SHARE else None
            if shape is not None:
                dyes = self._dyes(shape)
                fitting = [part for part in alike if _fits(shape.size, part.size)]
                others |= {part: _stood_in(shape, dyes, part) for part in fitting}
        kept = tuple(p for p in patches if p.part not in others)
        return kept + _held([p for own in others.values() for p in own], within=patches)

    def _shape(self, kind: Kind, size: Array) -> Shape | None:
        """A usable model of the kind that need not be stretched much to that size."""
        models = [m for m in self.models if kind in m.kinds and _fits(m.size, size)]
        shapes = (models[number].shape for number in self.rng.permutation(len(models)))
        return next((s for s in shapes if s is not None and s.top >= kind.top), None)

    def _dyes(self, shape: Shape) -> list[Texture]:
        """A texture for each material: in its own colour, or all of them stained."""
        stain = muted(self.rng) / _BRIGHT if self.rng.uniform() < 0.5 else np.ones(3)
        return [plain(self.rng, np.minimum(stain * colour, 255)) for colour in shape.colours]


def exchange_for(seed: int, library: Library) -> Exchange:
    """For the room of a seed."""
    return Exchange(library.of(split_of(seed)), np.random.default_rng([seed, 2]))


def _fits(model: Array, size: Array) -> bool:
    scale = size / model
    within = _SCALES[0] <= scale.min() and scale.max() <= _SCALES[1]
    return bool(within and scale.max() <= _STRETCH * scale.min())


def _stood_in(shape: Shape, dyes: Iterable[Texture], part: Part) -> Patches:
    """A model scaled to the box of a part."""
    corners = shape.corners * (part.size / shape.size)
    patches = []
    for number, dye in enumerate(dyes):
        own = corners[shape.material == number]
        if len(own):
            uv = _flattened(own) / dye.texel_m
            patches.append(Patch(own, uv, dye, part.kind.surface))
    return moved(patches, part.target_T_part)


def _held(patches: Iterable[Patch], within: Patches) -> Patches:
    """Models with the corners that turned boxes reach beyond a piece's own box pushed back."""
    points = np.concatenate([p.corners.reshape(-1, 3) for p in within])
    low, high = points.min(axis=0), points.max(axis=0)
    return tuple(replace(p, corners=p.corners.clip(low, high)) for p in patches)


def _flattened(corners: Array) -> Array:
    """(n, 4, 2) metres on the quadrilaterals, seen along the axis that they face most."""
    facing = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    across = np.array([[1, 2], [0, 2], [0, 1]])[np.abs(facing).argmax(axis=1)]
    return np.take_along_axis(corners, across[:, None], axis=2)
