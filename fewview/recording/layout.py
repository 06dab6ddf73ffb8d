"""Where everything is in a recording, and the blueprint that opens it on the answer."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Flag, IntEnum, auto
from functools import reduce
from operator import or_

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn

from fewview.types import Array, CompletedRoom

TIMELINE = "step"
SCANS = "scans"
ROOMS = "rooms"
UNPLACED = "unplaced"
RING_TITLES = {
    "semantics": "Semantics",
    "depth": "Depth",
    "normals": "Normals",
    "confidence": "Confidence",
}
"""Entities and names of the pictures that show the seen above the completed 360-image."""
MAX_PAIR_VIEWS = 8
HALF_VIEW = 0.9 * float(np.tan(np.radians(55.0 / 2)))
"""Tangent of half the viewer's vertical field of view, less a margin for labels and frusta."""

_LOG_COLUMNS = rrb.TextLogColumns(
    text_log_columns=[TextLogColumn("LogLevel"), TextLogColumn("Body")]
)


class Step(IntEnum):
    """The stages of a run, on the timeline that one scrubs."""

    INPUT = 0
    SCANS = 1
    PAIRS = 2
    SOLVED = 3
    MESH = 4
    DONE = 5


@dataclass(frozen=True)
class Eye:
    """From where a 3D view looks: position and target (3,), metres."""

    position: Array
    target: Array


class RoomParts(Flag):
    """Which representations of the completed rooms there are."""

    PANORAMA = auto()
    LAYOUT = auto()
    PLANES = auto()

    @classmethod
    def of(cls, room: CompletedRoom) -> RoomParts:
        """Those of one scan."""
        parts = {cls.PANORAMA: room.panorama, cls.LAYOUT: room.layout, cls.PLANES: room.planes}
        return reduce(or_, (part for part, made in parts.items() if made is not None), cls(0))


@dataclass(frozen=True)
class Space:
    """One component: a world frame of its own, unrelated to the others.

    Attributes:
        component: its number.
        scans: the names of its scans.
        centres: (n, 3) where their cameras stand.
        eye: where the view of the answer looks from.
        rooms_eye: where the view of the completed rooms looks from.
    """

    component: int
    scans: tuple[str, ...]
    centres: Array
    eye: Eye
    rooms_eye: Eye

    @property
    def root(self) -> str:
        return world(self.component)


def path(*parts: str) -> str:
    """An entity path; each part may hold any characters."""
    return str(rr.new_entity_path(list(parts)))


def world(component: int) -> str:
    """The root of a component: frames of different components are unrelated, so roots differ."""
    return "world" if component == 0 else f"world_{component}"


def pair(source: str, target: str) -> str:
    """The root of a pair of scans."""
    return path("pairs", f"{source}--{target}")


def short(names: Sequence[str]) -> tuple[str, ...]:
    """The names without the words that all of them begin with: labels must be brief."""
    words = [re.split(r"(?<=[-_. ])", name) for name in names]
    shared = 0
    while len({w[shared] for w in words}) == 1 and min(map(len, words)) > shared + 1:
        shared += 1
    return tuple("".join(w[shared:]) for w in words)


def eye(points: Array, centres: Array) -> Eye:
    """Look from behind and above the cameras (n, 3) at the points (m, 3), as near as shows all.

    The outermost percent of the points does not count: stray ones would push the eye far away.
    """
    seen = np.concatenate([np.percentile(points, [0.5, 99.5], axis=0), centres])
    low, high = seen.min(axis=0), seen.max(axis=0)
    shown = np.concatenate([points[np.all((points >= low) & (points <= high), axis=1)], centres])
    size = float(np.linalg.norm(high - low))
    behind = (centres.mean(axis=0) - points.mean(axis=0)) * (1.0, 1.0, 0.0)
    length = float(np.linalg.norm(behind))
    direction = behind / length if length > 0.05 * size else np.array([-0.6, -0.8, 0.0])
    backwards = 0.74 * direction + np.array([0.0, 0.0, 0.67])
    backwards /= np.linalg.norm(backwards)
    return _framing(shown, backwards)


def _framing(points: Array, backwards: Array) -> Eye:
    """The nearest eye that sees all points (n, 3) in a square picture, the view's axis given.

    A point at x across the axis and b backwards is seen from (s, d) when |x - s| is at most
    `HALF_VIEW` * (d - b): the largest sums and differences of x and `HALF_VIEW` * b decide.
    """
    right = np.cross([0.0, 0.0, 1.0], backwards)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(backwards, right)])
    middle = points.mean(axis=0)
    across = (points - middle) @ axes.T
    spread = HALF_VIEW * ((points - middle) @ backwards)[:, None]
    above, below = (spread + across).max(axis=0), (spread - across).max(axis=0)
    target = middle + (above - below) / 2 @ axes
    distance = float((above + below).max()) / (2 * HALF_VIEW)
    return Eye(target + distance * backwards, target)


def blueprint(
    names: Sequence[str],
    spaces: Sequence[Space],
    gallery: Eye | None,
    pairs: Sequence[tuple[int, int]],
    rooms: RoomParts,
) -> rrb.Blueprint:
    """The answer in 3D at the left, what it rests on at the right.

    Args:
        names: all scans.
        spaces: the components, largest first; empty while nothing is solved.
        gallery: where to look at scans outside all components, None when there are none.
        pairs: source and target of the recorded pairs, the most telling first.
        rooms: what is recorded of the completed rooms.
    """
    spatial: list[rrb.View | rrb.Container] = [_component_view(s) for s in spaces]
    if rooms & (RoomParts.PANORAMA | RoomParts.PLANES):
        spatial += [_rooms_view(s) for s in spaces]
    if gallery is not None:
        spatial.append(_gallery_view(names, gallery))
    evidence = rrb.Tabs(
        rrb.TextDocumentView(origin="summary", name="Summary"),
        _image_grid(names, SCANS, "rgb", "Images"),
        _image_grid(names, SCANS, "depth", "Depth"),
        *_room_pictures(names, rooms),
        _pair_grid(names, pairs),
        rrb.TextDocumentView(origin="candidates", name="Candidates"),
        active_tab=0,
    )
    progress = rrb.Tabs(
        rrb.TextLogView(origin="log", name="Log", columns=_LOG_COLUMNS),
        rrb.BarChartView(origin="timings", name="Timings"),
        active_tab=0,
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Tabs(*spatial, active_tab=0),
            rrb.Vertical(evidence, progress, row_shares=[3, 1]),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=TIMELINE, play_state="following", state="collapsed"),
        collapse_panels=True,
    )


def _component_view(space: Space) -> rrb.View:
    name = "Answer" if space.component == 0 else f"Component {space.component}"
    return _spatial(space.root, name, space.eye, _hidden(space))


def _rooms_view(space: Space) -> rrb.View:
    """What the scans measured, with the points and planes that completion adds."""
    name = "Rooms" if space.component == 0 else f"Rooms of component {space.component}"
    depths = (path(space.root, SCANS, scan, "image", "depth") for scan in space.scans)
    answer = (path(space.root, "components"), path(space.root, "pose_graph"))
    return _spatial(space.root, name, space.rooms_eye, (*answer, *depths))


def _gallery_view(names: Sequence[str], eye: Eye) -> rrb.View:
    rooms = (path(UNPLACED, name, "room") for name in names)
    return _spatial(UNPLACED, "Scans not placed", eye, rooms)


def _spatial(root: str, name: str, eye: Eye, hidden: Iterable[str]) -> rrb.View:
    return rrb.Spatial3DView(
        origin=root,
        name=name,
        eye_controls=_controls(eye),
        overrides={p: rrb.EntityBehavior(visible=False) for p in hidden},
    )


def _controls(eye: Eye) -> rrb.EyeControls3D:
    return rrb.EyeControls3D(position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0))


def _hidden(space: Space) -> Iterable[str]:
    """What clutters the first look; one click in the viewer shows it."""
    yield path(space.root, "pose_graph", "before")
    yield path(space.root, "pose_graph", "rejected")
    for name in space.scans:
        yield path(space.root, SCANS, name, "points")
        yield path(space.root, SCANS, name, "image", "depth")
        yield path(space.root, SCANS, name, "room")


def _image_grid(names: Sequence[str], root: str, image: str, title: str) -> rrb.Container:
    views = [
        rrb.Spatial2DView(origin=path(root, name, image), name=label)
        for name, label in zip(names, short(names), strict=True)
    ]
    return rrb.Grid(*views, name=title)


def _room_pictures(names: Sequence[str], rooms: RoomParts) -> list[rrb.Container]:
    """One tab, or none: the 360-images, seen above completed, over the layouts."""
    parts: list[rrb.Container] = []
    if RoomParts.PANORAMA in rooms:
        grids = (_image_grid(names, ROOMS, image, title) for image, title in RING_TITLES.items())
        parts.append(rrb.Tabs(*grids, active_tab=0))
    if RoomParts.LAYOUT in rooms:
        parts.append(_image_grid(names, ROOMS, "layout", "Layouts"))
    return [rrb.Vertical(*parts, name="Rooms")] if parts else []


def _pair_grid(names: Sequence[str], pairs: Sequence[tuple[int, int]]) -> rrb.Container:
    labels = short(names)
    views = [
        rrb.Spatial2DView(origin=pair(names[a], names[b]), name=f"{labels[a]} - {labels[b]}")
        for a, b in pairs[:MAX_PAIR_VIEWS]
    ]
    return rrb.Grid(*views, grid_columns=2, name="Matches")
