"""What a method answers for a set of scans: run once, kept, scored as often as wanted."""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from measure import Measured, measure
from scenes import Scene
from sets import FrameSet

Json = dict[str, Any]
SCRIPTS = Path(__file__).resolve().parent
ROOT = SCRIPTS.parent
FINISHED = (0, 3)
"""Exit codes after which a report exists: everything placed, or some scans left out."""


@dataclass(frozen=True)
class Task:
    """One method on one set of one scene.

    Attributes:
        scene: where the frames are.
        chosen: which frames.
        turns: quarter turns by name, for the roll experiment.
        method: ``fewview``, ``identity`` or a peer's name.
        options: further arguments of ``fewview reconstruct``.
        jobs: processes or threads the method may use.
    """

    scene: Scene
    chosen: FrameSet
    turns: Mapping[str, int]
    method: str
    options: tuple[str, ...]
    jobs: int

    @property
    def file(self) -> Path:
        """Where below the cache the prediction is kept; its name changes with the code."""
        given = json.dumps([dict(self.turns), self.options, self.jobs, self.chosen.names])
        code = hashlib.sha256((_fingerprint(self.method) + given).encode()).hexdigest()[:12]
        return Path(self.scene.name) / self.chosen.id / f"{self.method}-{code}.json"


def predict(task: Task, cache: Path) -> Json:
    """``{"report", "measured"}`` of a task, from the cache or by running the method."""
    path = cache / task.file
    if path.is_file():
        stored: Json = json.loads(path.read_text())
        return stored
    prediction = _identity(task) if task.method == "identity" else _run(task)
    if prediction["report"] is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text(json.dumps(prediction))
        part.replace(path)
    return prediction


def _run(task: Task) -> Json:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scans, out = folder / "scans", folder / "out"
        scans.mkdir()
        out.mkdir()
        task.scene.write(task.chosen.names, task.turns, scans)
        measured = _measured(task, scans, out)
        report = out / "mesh.json"
        finished = measured.code in FINISHED and report.is_file()
        return {
            "report": json.loads(report.read_text()) if finished else None,
            "measured": asdict(measured),
        }


def _measured(task: Task, scans: Path, out: Path) -> Measured:
    module = "fewview" if task.method == "fewview" else "peers"
    command: list[str | Path] = [sys.executable, "-m", module]
    if task.method == "fewview":
        command += ["reconstruct", scans, "--out", out / "mesh.ply", "--seed", "0"]
        command += task.options
    else:
        command += [scans, "--method", task.method, "--out", out / "mesh.json"]
    environment = {"OMP_NUM_THREADS": "1", "PYTHONPATH": f"{ROOT}:{SCRIPTS}"}
    return measure([*command, "--jobs", str(task.jobs)], environment, out)


def _identity(task: Task) -> Json:
    scans = [
        {"name": name, "placed": True, "component": 0, "world_T_scan": np.eye(4).tolist()}
        for name in task.chosen.names
    ]
    return {"report": {"scans": scans, "pairs": []}, "measured": None}


def _fingerprint(method: str) -> str:
    """A hash of the code that a method runs; how it is evaluated changes no answer."""
    folders = {"fewview": [ROOT / "fewview", ROOT / "configs"], "identity": []}
    digest = hashlib.sha256()
    for folder in folders.get(method, [SCRIPTS / "peers"]):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in (".py", ".yaml", ".json")):
            if "evaluation" not in path.parts:
                digest.update(path.read_bytes())
    return digest.hexdigest()
