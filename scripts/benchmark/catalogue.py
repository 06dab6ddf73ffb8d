"""All methods by name; free of heavy imports, so that what is stored can be scored at once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from benchmark.code import fingerprint
from benchmark.methods.interface import PairMethod

OURS = "benchmark.methods.ours"
LOCAL_LABELS: Mapping[str, str] = {
    "icp": "ICP",
    "gicp": "GICP",
    "sparse_icp": "SparseICP",
    "ours": "Ours-Local",
}
"""Keys of `benchmark.methods.local.LOCALS`, as tables print them."""


def key_of(name: str, settings: object, modules: Sequence[str]) -> str:
    """``name`` with twelve hex digits of settings and of the code of modules."""
    text = json.dumps(settings, sort_keys=True) + "".join(map(fingerprint, modules))
    return f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


@dataclass(frozen=True)
class Method:
    """A relative-pose method.

    Attributes:
        label: as tables print it.
        module: where its class is; its code and all that it imports key the stored answers.
        maker: the class.
        arguments: of the class.
        local: refine its candidates with this key of `benchmark.methods.local.LOCALS`.
    """

    label: str
    module: str
    maker: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    local: str | None = None

    def __hash__(self) -> int:
        return hash(self.key)

    def make(self) -> PairMethod:
        """The method itself; imports what it needs."""
        made: PairMethod = getattr(import_module(self.module), self.maker)(**self.arguments)
        if self.local is None:
            return made
        refined: PairMethod = import_module("benchmark.methods.local").Refined(made, self.local)
        return refined

    @property
    def key(self) -> str:
        """A name for folders: what it is, and fingerprints of its settings and its code."""
        modules = [self.module] + ["benchmark.methods.local"] * (self.local is not None)
        return key_of(self.maker, [dict(self.arguments), self.local], modules)


@dataclass(frozen=True)
class MultiMethod:
    """A way from pairs to the poses of a set of scans.

    Attributes:
        label: as tables print it.
        pairs: key of `PAIR_METHODS`.
        backend: module with a function ``solve``.
        arguments: of that function.
        consecutive: only neighbours in the scan order are matched.
        views: the back-end looks at the prepared scans, as an argument ``views``.
    """

    label: str
    pairs: str
    backend: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    consecutive: bool = False
    views: bool = False

    @property
    def key(self) -> str:
        """As `Method.key`, for the back-end and the pairs that it gets."""
        given = [dict(self.arguments), PAIR_METHODS[self.pairs].key, self.consecutive]
        return key_of(self.backend.rpartition(".")[-1], given, [self.backend])


def _ours(label: str, maker: str = "Ours", **settings: Any) -> Method:
    return Method(label, OURS, maker, {"settings": settings})


def _global(
    label: str, kinds: Sequence[str] | None = None, above: bool = False, top_k: int = 5
) -> Method:
    """The global module alone: no refinement; some kinds of features, poses from above or not."""
    settings: dict[str, Any] = {
        "matching": {"manhattan": above, "alignment": above, "top_k": top_k},
        "refinement": {"iterations": 0},
    }
    if kinds is not None:
        settings["features"] = {"kinds": list(kinds)}
    return _ours(label, **settings)


_SEEN = ("xfeat", "sift", "planes")

PAIR_METHODS: Mapping[str, Method] = {
    "identity": Method("identity", "benchmark.methods.trivial", "Identity"),
    "uniform_yaw": Method("uniform yaw", "benchmark.methods.trivial", "UniformYaw"),
    "manhattan_random": Method(
        "Manhattan snap, random order", "benchmark.methods.trivial", "ManhattanRandom"
    ),
    "manhattan_away": Method(
        "Manhattan snap, facing away first", "benchmark.methods.trivial", "ManhattanFacingAway"
    ),
    "4pcs": Method("Super4PCS", "benchmark.methods.four_points", "FourPoints"),
    "fgr": Method("RobustGR (FGR)", "benchmark.methods.fgr", "FGR", {"icp": False}),
    "fgr_icp": Method("FGR + ICP", "benchmark.methods.fgr", "FGR"),
    "ransac": Method("RANSAC", "benchmark.methods.ransac", "Ransac", {"icp": False}),
    "ransac_icp": Method("RANSAC + ICP", "benchmark.methods.ransac", "Ransac"),
    "kiss_icp": Method("KISS-Matcher + ICP", "benchmark.methods.kiss", "Kiss"),
    "xfeat": Method("XFeat + LighterGlue", "benchmark.methods.xfeat", "XFeat", {"icp": False}),
    "xfeat_icp": Method("XFeat + LighterGlue + ICP", "benchmark.methods.xfeat", "XFeat"),
    "sparse_icp": Method("SparseICP", "benchmark.methods.sparse_icp", "SparseICP"),
    "scan_complete": _global("ScanComplete (360-image alone)", ["panorama"], top_k=1),
    "ours_local": _ours("Ours-Local", "OursLocal"),
    "ours_global": _global("Ours-Global", above=True),
    "ours": _ours("Ours"),
    "ours_seen": _ours("Ours, nothing completed", features={"kinds": list(_SEEN)}),
    "panorama": _global("360-image", ["panorama"]),
    "planes": _global("Planes", ["planes", "structure"]),
    "layout": _global("2D layout", ["layout"]),
    "completed": _global("The three together", ["panorama", "planes", "structure", "layout"]),
    "keypoints": _global("Keypoints", ["xfeat", "sift"]),
    "spectral": _global("All features, no poses from above"),
}
"""Relative-pose methods; those with one candidate answer top-3 and top-5 with it too."""


_GRAPH = "benchmark.backends.components"


def _pose_graph(label: str, pairs: str, optimiser: str, min_score: int = 0) -> MultiMethod:
    return MultiMethod(label, pairs, _GRAPH, {"optimiser": optimiser, "min_score": min_score})


def _ours_top(k: int, pairs: str = "ours", together: bool = True) -> MultiMethod:
    alone = "" if together else ", candidates alone"
    label = f"{PAIR_METHODS[pairs].label}, top-{k}{alone}"
    arguments = {"top_k": k, "together": together}
    return MultiMethod(label, pairs, "benchmark.backends.ours", arguments, views=True)


MULTI_METHODS: Mapping[str, MultiMethod] = {
    "identity": MultiMethod("identity", "identity", "benchmark.backends.identity"),
    "fine2coarse": MultiMethod(
        "Fine2C", "xfeat_icp", "benchmark.backends.scan_order", consecutive=True
    ),
    "robustrec": _pose_graph("RobustRec (RANSAC)", "ransac_icp", "robust_rec"),
    "fgr_robustrec": _pose_graph("FGR + RobustRec", "fgr_icp", "robust_rec"),
    "kiss_robustrec": _pose_graph("KISS-Matcher + RobustRec", "kiss_icp", "robust_rec"),
    "xfeat_robustrec": _pose_graph("XFeat + RobustRec", "xfeat_icp", "robust_rec", 15),
    "xfeat_gnc": _pose_graph("XFeat + GNC", "xfeat_icp", "gnc", 15),
    "seen_top5": _ours_top(5, "ours_seen"),
    "ours_top1": _ours_top(1),
    "ours_top3": _ours_top(3),
    "ours_top5": _ours_top(5),
    "ours_alone": _ours_top(5, together=False),
}
"""Multi-scan methods; RANSAC with the pose graph is the paper's RobustRecons."""
