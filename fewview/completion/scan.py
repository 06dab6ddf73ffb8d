"""Everything the pair stages need of one scan, by one file per kind of feature (Sec. 3.2)."""

from __future__ import annotations

import numpy as np

from fewview.completion.kinds import FeatureKind, ScanView
from fewview.completion.layout.features import Layout
from fewview.completion.levelling import doubted, level
from fewview.completion.local_geometry import DepthView, thin_surface
from fewview.completion.panorama.features import Panorama
from fewview.completion.patches import find_patches
from fewview.completion.planes import Planes
from fewview.completion.room import NETWORKS, complete_room, without_descriptors
from fewview.completion.sift import Sift
from fewview.completion.structure.features import Structure
from fewview.completion.xfeat import XFeatKeypoints
from fewview.config import FeatureConfig
from fewview.errors import ConfigError
from fewview.types import Array, CompletedScan, Frame

OBSERVED_KINDS: tuple[FeatureKind, ...] = (XFeatKeypoints(), Sift(), Planes())
COMPLETED_KINDS: tuple[FeatureKind, ...] = (Panorama(), Layout(), Structure())
KINDS = OBSERVED_KINDS + COMPLETED_KINDS


def chosen_kinds(config: FeatureConfig) -> tuple[FeatureKind, ...]:
    """The kinds that the settings name.

    Raises:
        ConfigError: one of them does not exist.
    """
    known = {kind.name: kind for kind in KINDS}
    if unknown := sorted(set(config.kinds) - known.keys()):
        raise ConfigError(
            f"features.kinds: unknown kind '{unknown[0]}'; there are {', '.join(known)}"
        )
    return tuple(kind for kind in KINDS if kind.name in config.kinds)


def asked_networks(config: FeatureConfig) -> frozenset[str]:
    """The networks whose completion the settings make use of."""
    return frozenset(config.kinds).intersection(NETWORKS)


def complete(
    name: str,
    frame: Frame,
    quarter_turns: int,
    config: FeatureConfig,
    seed: int,
    up: Array | None = None,
) -> CompletedScan:
    """Everything the pair stages need to know of one scan.

    Args:
        name: the scan's name.
        frame: its pixels.
        quarter_turns: counter-clockwise turns that bring the image upright.
        config: settings.
        seed: seed of the plane search.
        up: (3,) unit up direction in its camera axes where it is known.
    """
    depth = DepthView.of(frame, config.max_depth_m)
    surface = thin_surface(depth, frame.colour, config.surface_voxel_m)
    surface, patches = find_patches(surface, config.max_patches, np.random.default_rng(seed))
    levelling = level(surface, patches, quarter_turns, up)
    room = complete_room(frame, levelling, asked_networks(config), config.max_depth_m, seed)
    if room.layout is not None:
        levelling = doubted(levelling, room.layout.floor_z)
    view = ScanView(frame, quarter_turns, depth, surface, patches, levelling, room)
    return CompletedScan(
        name=name,
        image_size=(frame.intrinsics.width, frame.intrinsics.height),
        quarter_turns=quarter_turns,
        intrinsics=depth.intrinsics,
        depth=depth.depth,
        surface=surface,
        patches=patches,
        levelling=levelling,
        room=without_descriptors(room),
        features={kind.name: kind.extract(view, config) for kind in chosen_kinds(config)},
    )
