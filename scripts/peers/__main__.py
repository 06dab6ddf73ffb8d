"""``python -m peers FOLDER --method NAME --out report.json``: one peer on one folder of scans."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import open3d as o3d
import torch

from peers.catalogue import PEERS
from peers.methods import run
from scenes import Scene


def main() -> None:
    """Run a peer and write its report; every library is held to one thread a job."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", choices=sorted(PEERS), required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    o3d.utility.random.seed(0)
    scene = Scene(arguments.folder)
    frames = [scene.load(name) for name in scene.names]
    report = run(PEERS[arguments.method], scene.names, frames, arguments.jobs)
    arguments.out.write_text(json.dumps(report))


if __name__ == "__main__":
    main()
