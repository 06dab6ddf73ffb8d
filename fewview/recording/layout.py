"""Where everything is in a recording, and the blueprint that opens it on the answer."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn

from fewview.types import Array

TIMELINE = "step"
UNPLACED = "unplaced"
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


@dataclass(frozen=True)
class Space:
    """One component: a world frame of its own, unrelated to the others.

    Attributes:
        component: its number.
        scans: the names of its scans.
        centres: (n, 3) where their cameras stand.
        eye: where its view looks from.
    """

    component: int
    scans: tuple[str, ...]
    centres: Array
    eye: Eye

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
) -> rrb.Blueprint:
    """The answer in 3D at the left, what it rests on at the right.

    Args:
        names: all scans.
        spaces: the components, largest first; empty while nothing is solved.
        gallery: where to look at scans outside all components, None when there are none.
        pairs: source and target of the recorded pairs, the most telling first.
    """
    spatial: list[rrb.View | rrb.Container] = [_component_view(s) for s in spaces]
    if gallery is not None:
        view = rrb.Spatial3DView(
            origin=UNPLACED, name="Scans not placed", eye_controls=_controls(gallery)
        )
        spatial.append(view)
    evidence = rrb.Tabs(
        rrb.TextDocumentView(origin="summary", name="Summary"),
        _image_grid(names, "rgb", "Images"),
        _image_grid(names, "depth", "Depth"),
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
    return rrb.Spatial3DView(
        origin=space.root,
        name="Answer" if space.component == 0 else f"Component {space.component}",
        eye_controls=_controls(space.eye),
        overrides={p: rrb.EntityBehavior(visible=False) for p in _hidden(space)},
    )


def _controls(eye: Eye) -> rrb.EyeControls3D:
    return rrb.EyeControls3D(position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0))


def _hidden(space: Space) -> Iterable[str]:
    """What clutters the first look; one click in the viewer shows it."""
    yield path(space.root, "pose_graph", "before")
    yield path(space.root, "pose_graph", "rejected")
    for name in space.scans:
        yield path(space.root, "scans", name, "points")
        yield path(space.root, "scans", name, "image", "depth")


def _image_grid(names: Sequence[str], image: str, title: str) -> rrb.Container:
    views = [
        rrb.Spatial2DView(origin=path("scans", name, image), name=label)
        for name, label in zip(names, short(names), strict=True)
    ]
    return rrb.Grid(*views, name=title)


def _pair_grid(names: Sequence[str], pairs: Sequence[tuple[int, int]]) -> rrb.Container:
    labels = short(names)
    views = [
        rrb.Spatial2DView(origin=pair(names[a], names[b]), name=f"{labels[a]} - {labels[b]}")
        for a, b in pairs[:MAX_PAIR_VIEWS]
    ]
    return rrb.Grid(*views, grid_columns=2, name="Matches")
