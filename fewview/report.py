"""What a run leaves on disk: mesh, report and trajectory, all of them or none."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fewview import __version__, ply
from fewview.types import (
    Alternative,
    Array,
    PairResult,
    PoseCandidate,
    Reconstruction,
    Registration,
)


def as_dict(result: Reconstruction, mesh_path: Path) -> dict[str, Any]:
    """The report's JSON object (format 1)."""
    names = [s.name for s in result.scans.scans]
    solution = result.solution
    return {
        "fewview": __version__,
        "format": 1,
        "seed": result.seed,
        "config_hash": result.config_hash,
        "units": "m",
        "pose_convention": "camera-to-world, OpenCV axes",
        "scans": [
            {
                "name": p.name,
                "placed": p.placed,
                "component": p.component,
                "world_T_scan": _placed(p.world_T_scan),
                "probability": _number(p.probability),
                "reason": p.reason,
            }
            for p in solution.placements
        ],
        "pairs": [
            pair_dict(pair, names, solution.selected.get((pair.source, pair.target)))
            for pair in result.pairs
        ],
        "components": [
            {
                "scans": [names[i] for i in c.scans],
                "world": c.world,
                "nearest_link": c.nearest_link,
                "registration": _registration(c.registration),
                "mesh": None if not result.meshes else mesh_name(mesh_path, number).name,
            }
            for number, c in enumerate(solution.components)
        ],
        "pose_graph": [
            {
                "source": names[e.source],
                "target": names[e.target],
                "rank": e.rank,
                "weight": _number(e.weight),
                "before_m": _number(e.before_m),
                "after_m": _number(e.after_m),
                "before_deg": _number(np.degrees(e.before_rad)),
                "after_deg": _number(np.degrees(e.after_rad)),
            }
            for e in solution.edges
        ],
        "alternatives": [_alternative(a, names) for a in solution.alternatives],
        "timings_s": {k: _number(v) for k, v in result.timings_s.items()},
        "mesh": {
            "vertices": len(result.meshes[0].vertices) if result.meshes else 0,
            "faces": len(result.meshes[0].faces) if result.meshes else 0,
            "path": mesh_path.name if result.meshes else None,
        },
    }


def pair_dict(pair: PairResult, names: Sequence[str], selected: int | None) -> dict[str, Any]:
    """A pair's entry in the report."""
    return {
        "source": names[pair.source],
        "target": names[pair.target],
        "status": str(pair.status),
        "reason": pair.reason,
        "selected": selected,
        "candidates": [_candidate(c) for c in pair.candidates],
    }


def mesh_name(path: Path, component: int) -> Path:
    """``mesh.ply`` for the largest component, ``mesh.component1.ply`` and so on for the others."""
    return path if component == 0 else path.with_suffix(f".component{component}{path.suffix}")


def save(result: Reconstruction, mesh_path: str | Path, report_path: Path | None = None) -> Path:
    """Write mesh(es), ``NAME.json`` and ``NAME.tum.txt``; everything appears at once, at the end.

    Returns:
        the path of the report.
    """
    mesh_path = Path(mesh_path)
    report_path = report_path or mesh_path.with_suffix(".json")
    contents: dict[Path, bytes] = {
        mesh_name(mesh_path, i): ply.encode(mesh) for i, mesh in enumerate(result.meshes)
    }
    text = json.dumps(as_dict(result, mesh_path), indent=1, allow_nan=False)
    contents[report_path] = text.encode()
    contents[mesh_path.with_suffix(".tum.txt")] = _trajectory(result).encode()
    _write_all(contents)
    return report_path


def _write_all(contents: dict[Path, bytes]) -> None:
    """Write every file beside its final name first, then rename them all."""
    staged = {path: path.with_name(f".{path.name}.{os.getpid()}.part") for path in contents}
    try:
        for path, content in contents.items():
            staged[path].write_bytes(content)
        for path, temporary in staged.items():
            os.replace(temporary, path)
    finally:
        for temporary in staged.values():
            temporary.unlink(missing_ok=True)


def _trajectory(result: Reconstruction) -> str:
    """TUM lines of the largest component: scan index, position, quaternion x y z w."""
    lines = []
    for index, placement in enumerate(result.solution.placements):
        if placement.world_T_scan is not None and placement.component == 0:
            values = [*placement.world_T_scan[:3, 3], *_quaternion(placement.world_T_scan)]
            lines.append(" ".join([str(index), *(f"{v:.9f}" for v in values)]))
    return "\n".join(lines) + "\n" if lines else ""


def _quaternion(pose: Array) -> Array:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(pose[:3, :3]).as_quat())


def _candidate(candidate: PoseCandidate) -> dict[str, Any]:
    evidence = candidate.evidence
    return {
        "rank": candidate.rank,
        "origin": str(candidate.origin),
        "target_T_source": _matrix(candidate.target_T_source),
        "score": _number(candidate.score),
        "probability": _number(candidate.probability),
        "residual_m": _number(evidence.residual_m),
        "overlap": _number(evidence.overlap),
        "free_space_violation": _number(evidence.free_space_violation),
        "support": {str(k): int(v) for k, v in evidence.support.items()},
    }


def _registration(registration: Registration | None) -> dict[str, Any] | None:
    if registration is None:
        return None
    return {
        "residual_before_m": _number(registration.residual_before_m),
        "residual_after_m": _number(registration.residual_after_m),
        "accepted": registration.accepted,
    }


def _alternative(alternative: Alternative, names: Sequence[str]) -> dict[str, Any]:
    """Only the scans that stand otherwise; without a pose they stand alone."""
    return {
        "margin": _number(alternative.margin),
        "odds": _number(alternative.odds),
        "differs": [names[place.scan] for place in alternative.places],
        "scans": [
            {
                "name": names[place.scan],
                "component": place.component,
                "world_T_scan": _placed(place.world_T_scan),
            }
            for place in alternative.places
        ],
    }


def _placed(pose: Array | None) -> list[list[float]] | None:
    return None if pose is None else _matrix(pose)


def _matrix(pose: Array) -> list[list[float]]:
    return [[_number(v) for v in row] for row in pose]


def _number(value: float) -> float:
    """Rounded to what can be meant, and finite, as strict JSON needs."""
    if not np.isfinite(value):
        raise ValueError("a result is not a finite number")
    return round(float(value), 9)
