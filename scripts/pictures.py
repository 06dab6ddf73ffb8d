"""Pictures of finished runs for the documentation.

    python scripts/pictures.py REPORT_FOLDER... --out docs/images

Each folder holds ``mesh.ply``, ``mesh.json`` and ``mesh.rrd`` of one run of ``fewview reconstruct``
and gives ``NAME-mesh.png``, the mesh and its scans from above, and ``NAME-recording.png``, the
recording as the Rerun viewer opens it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
from PIL import Image
from rerun.experimental import ViewerClient

from fewview.geometry import se3
from fewview.ply import read_ply
from fewview.types import Array, ColouredMesh

WIDTH, HEIGHT, SAMPLES = 1200, 800, 2
MARGIN = 0.05
ELEVATION_DEG, AZIMUTHS, DISTANCE = 40.0, 24, 1.2
"""Height of the eye, directions tried, and distance in sizes of the scene."""
MOST_BYTES = 400_000

BACKGROUND = (222, 227, 233)
SHADE = 0.25
"""How much darker than its colour a surface is that one sees edge-on."""
FRUSTUM_COLOUR, FRUSTUM_M = (0, 90, 230), 0.22
FRUSTUM_CORNERS = FRUSTUM_M * np.array(
    [[0, 0, 0], [-0.6, -0.45, 1], [0.6, -0.45, 1], [0.6, 0.45, 1], [-0.6, 0.45, 1]]
)
"""A symbol of a camera: the report does not say what each camera's field of view is."""
FRUSTUM_EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1))

WINDOW, MENU_PX = "1400x886", 36
"""Size of the viewer's window, and of the bar on top that says nothing of the recording."""
START_S, LOAD_S, SETTLE_S = 60.0, 60.0, 5.0


@dataclass(frozen=True)
class View:
    """A camera that looks at a scene.

    Attributes:
        camera_T_world: (4, 4), OpenCV axes.
        matrix: (3, 3) calibration of the picture with all its samples.
    """

    camera_T_world: Array
    matrix: Array

    @property
    def eye(self) -> Array:
        """The camera's centre (3,) in the world."""
        return np.asarray(se3.inverse(self.camera_T_world)[:3, 3])

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of world points (n, 3)."""
        homogeneous = se3.transform(self.camera_T_world, points) @ self.matrix.T
        return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path, metavar="REPORT_FOLDER")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for run in options.runs:
        name = run.resolve().name
        save(mesh_picture(run), options.out / f"{name}-mesh.png")
        save(recording_picture(run / "mesh.rrd"), options.out / f"{name}-recording.png")


def save(picture: Image.Image, path: Path) -> None:
    """Write a PNG, with as many colours as `MOST_BYTES` allow."""
    for colours in (256, 128, 64, 32):
        reduced = picture.convert("RGB").quantize(colours, dither=Image.Dither.NONE)
        reduced.save(path, optimize=True)
        if path.stat().st_size <= MOST_BYTES:
            break
    print(f"{path}: {path.stat().st_size // 1000} kB, {colours} colours")


def mesh_picture(run: Path) -> Image.Image:
    """The mesh of the largest component from above, with the cameras of its scans."""
    mesh = read_ply(run / "mesh.ply")
    scans = json.loads((run / "mesh.json").read_text())["scans"]
    poses = [np.array(scan["world_T_scan"]) for scan in scans if scan["component"] == 0]
    frusta = np.stack([se3.transform(pose, FRUSTUM_CORNERS) for pose in poses])
    view = look_at(mesh, frusta.reshape(-1, 3))
    picture = render(mesh, view)
    for corners in frusta:
        draw_frustum(picture, view.project(corners))
    return Image.fromarray(cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA))


def look_at(mesh: ColouredMesh, cameras: Array) -> View:
    """From above and from where most of the surface faces the eye, filled by mesh and cameras."""
    seen = np.concatenate([np.percentile(mesh.vertices, [0.5, 99.5], axis=0), cameras])
    low, high = seen.min(axis=0), seen.max(axis=0)
    kept = np.all((mesh.vertices >= low) & (mesh.vertices <= high), axis=1)
    eye = (low + high) / 2 + DISTANCE * np.linalg.norm(high - low) * _direction(mesh)
    camera_T_world = _facing(eye, (low + high) / 2)
    flat = View(camera_T_world, np.eye(3)).project(
        np.concatenate([mesh.vertices[kept][::7], cameras])
    )
    size = np.array([WIDTH, HEIGHT]) * SAMPLES
    low, high = flat.min(axis=0), flat.max(axis=0)
    focal = float(np.min((1 - 2 * MARGIN) * size / (high - low)))
    cx, cy = size / 2 - focal * (low + high) / 2
    return View(camera_T_world, np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]))


def _direction(mesh: ColouredMesh) -> Array:
    """The unit vector (3,) towards the eye."""
    azimuths = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    elevation = np.radians(ELEVATION_DEG)
    level = np.stack([np.cos(azimuths), np.sin(azimuths), np.full(AZIMUTHS, np.tan(elevation))], 1)
    directions = level * np.cos(elevation)
    area = np.maximum(_area_normals(mesh) @ directions.T, 0.0).sum(axis=0)
    return np.asarray(directions[np.argmax(area)])


def _facing(eye: Array, target: Array) -> Array:
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    world_T_camera = np.eye(4)
    world_T_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    world_T_camera[:3, 3] = eye
    return np.asarray(se3.inverse(world_T_camera))


def _area_normals(mesh: ColouredMesh) -> Array:
    """Face normals (m, 3) as long as the faces are large."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a) / 2)


def _vertex_normals(mesh: ColouredMesh) -> Array:
    """Unit normals (n, 3), each the mean over the faces around a vertex."""
    normals = np.zeros_like(mesh.vertices)
    np.add.at(normals, mesh.faces, _area_normals(mesh)[:, None])
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))


def render(mesh: ColouredMesh, view: View) -> Array:
    """Ray-cast the faces that are turned to the eye: ceilings and near walls do not hide the room.

    Returns:
        (H, W, 3) uint8 with `SAMPLES` times the picture's width and height.
    """
    towards = view.eye - mesh.vertices
    front = np.einsum("ij,ij->i", _area_normals(mesh), towards[mesh.faces[:, 0]]) > 0
    faces, normals = mesh.faces[front], _vertex_normals(mesh)
    cosine = np.einsum("ij,ij->i", normals, towards) / np.linalg.norm(towards, axis=1)
    shaded = mesh.colours * (1 - SHADE * (1 - np.maximum(cosine, 0)))[:, None]

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), faces.astype(np.uint32))
    rays = scene.create_rays_pinhole(
        view.matrix, view.camera_T_world, WIDTH * SAMPLES, HEIGHT * SAMPLES
    )
    answer = scene.cast_rays(rays)
    hit = np.isfinite(answer["t_hit"].numpy())
    face, uv = answer["primitive_ids"].numpy()[hit], answer["primitive_uvs"].numpy()[hit]
    weights = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
    picture = np.full((*hit.shape, 3), BACKGROUND, np.uint8)
    picture[hit] = np.einsum("ij,ijk->ik", weights, shaded[faces[face]])
    return picture


def draw_frustum(picture: Array, corners: Array) -> None:
    """Draw a camera, given the pixels (5, 2) of its centre and its image corners."""
    ends = np.round(corners).astype(int).tolist()
    for colour, width in (((255, 255, 255), 4 * SAMPLES), (FRUSTUM_COLOUR, 2 * SAMPLES)):
        for a, b in FRUSTUM_EDGES:
            cv2.line(picture, ends[a], ends[b], colour, width, cv2.LINE_AA)


def recording_picture(recording: Path) -> Image.Image:
    """What one sees when one opens a recording in the Rerun viewer."""
    with tempfile.TemporaryDirectory() as folder, viewer() as client:
        path = Path(folder) / "screen.png"
        client.open(str(recording.resolve()))
        deadline = time.monotonic() + LOAD_S
        while client.get_state().loading and time.monotonic() < deadline:
            time.sleep(0.5)
        time.sleep(SETTLE_S)
        client.save_screenshot(str(path))
        screen = Image.open(path).convert("RGB")
    return screen.crop((0, MENU_PX, screen.width, screen.height))


@contextmanager
def viewer() -> Iterator[ViewerClient]:
    """A Rerun viewer without a window, reachable from this machine only."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    rerun = shutil.which("rerun", path=str(Path(sys.executable).parent)) or "rerun"
    address = ["--bind", "127.0.0.1", "--port", str(port)]
    process = subprocess.Popen(
        [rerun, "--headless", *address, "--window-size", WINDOW],
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # the command starts the viewer as a child: both must end
    )
    try:
        yield _connect(f"rerun+http://127.0.0.1:{port}/proxy", process)
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()


def _connect(url: str, process: subprocess.Popen[bytes]) -> ViewerClient:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and process.poll() is None:
        try:
            client = ViewerClient.connect(url)
            client.get_state()
            return client
        except (RuntimeError, ConnectionError):
            time.sleep(0.5)
    raise SystemExit("the Rerun viewer does not start")


if __name__ == "__main__":
    main()
