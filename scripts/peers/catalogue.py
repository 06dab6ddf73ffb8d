"""The peers by name; free of heavy imports, so that what is stored can be scored at once."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Peer:
    """How a peer is put together.

    Attributes:
        estimator: key of `estimators.ESTIMATORS`.
        backend: key of `methods.BACKENDS`.
        min_support: edges with fewer inliers are dropped.
    """

    estimator: str
    backend: str
    min_support: int = 0


PEERS = {
    "xfeat_robustrec": Peer("xfeat", "robust_rec", min_support=15),
    "xfeat_gnc": Peer("xfeat", "gnc", min_support=15),
    "ransac_robustrec": Peer("ransac", "robust_rec"),
    "fgr_robustrec": Peer("fgr", "robust_rec"),
    "kiss_robustrec": Peer("kiss", "robust_rec"),
}
"""The first is the one to beat; RANSAC with the pose graph is the paper's RobustRecons."""
