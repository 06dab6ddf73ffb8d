"""Small scan folders of every layout, written byte by byte and independently of the readers."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fewview.geometry import se3
from fewview.types import Array

WIDTH, HEIGHT = 64, 48
CAMERA = np.array([[60.0, 0.0, 31.5], [0.0, 62.0, 23.5], [0.0, 0.0, 1.0]])
"""The depth camera of every sample."""


@dataclass(frozen=True)
class Sample:
    """What one written scan shows: RGB colour, raw depth values, camera-to-world pose."""

    colour: NDArray[np.uint8]
    raw: NDArray[np.uint16]
    world_T_scan: Array = field(default_factory=lambda: np.eye(4))


def colour_ramp(width: int, height: int, blue: int = 0) -> NDArray[np.uint8]:
    """Red grows to the right, green downwards; the same view at any size."""
    red = np.broadcast_to((np.arange(width) + 0.5) / width * 255, (height, width))
    green = np.broadcast_to(((np.arange(height) + 0.5) / height * 255)[:, None], (height, width))
    return np.stack([red, green, np.full_like(red, blue)], axis=-1).astype(np.uint8)


def samples(
    count: int = 3,
    colour_size: tuple[int, int] = (WIDTH, HEIGHT),
    depth_size: tuple[int, int] = (WIDTH, HEIGHT),
    raw_per_metre: float = 1000.0,
) -> list[Sample]:
    """Slanted walls 1.5 to 3 m away with a missing corner, seen from different poses."""
    made = []
    for i in range(count):
        metres = np.broadcast_to(np.linspace(1.5 + 0.1 * i, 3.0, depth_size[0]), depth_size[::-1])
        raw = np.rint(metres * raw_per_metre).astype(np.uint16)
        raw[:4, :4] = 0
        pose = se3.exp(np.array([0.1 * i, 0.2, 0.3, 0.5 * i, -0.25, 1.0]))
        made.append(Sample(colour_ramp(*colour_size, blue=40 * i), raw, pose))
    return made


def turned(scan: Sample) -> Sample:
    """Both images turned counter-clockwise by 90 degrees, the pose as it was."""
    return Sample(np.rot90(scan.colour).copy(), np.rot90(scan.raw).copy(), scan.world_T_scan)


def turned_camera(matrix: Array = CAMERA, width: int = WIDTH) -> Array:
    """The camera matrix that goes with `turned`."""
    (fx, _, cx), (_, fy, cy), _ = matrix
    return np.array([[fy, 0.0, cy], [0.0, fx, width - 1 - cx], [0.0, 0.0, 1.0]])


def encode(image: NDArray[Any], extension: str = ".png") -> bytes:
    """An image file's bytes; three channels are taken as RGB."""
    pixels = np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image
    return bytes(cv2.imencode(extension, pixels)[1].tobytes())


def put(path: Path, content: bytes | str) -> Path:
    """Write a file and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def rows(matrix: Array) -> str:
    """A matrix as lines of text."""
    return "\n".join(" ".join(repr(float(v)) for v in row) for row in matrix) + "\n"


def camera_json(matrix: Array = CAMERA, size: tuple[int, int] = (WIDTH, HEIGHT)) -> dict[str, Any]:
    """Open3D's camera file: the matrix column by column."""
    return {
        "width": size[0],
        "height": size[1],
        "intrinsic_matrix": matrix.T.ravel().tolist(),
    }


def write_seven_scenes(folder: Path, scans: list[Sample] | None = None) -> Path:
    """``frame-00000N.color.png``, depth, pose and ``intrinsics.txt``."""
    for i, scan in enumerate(samples() if scans is None else scans):
        put(folder / f"frame-{i:06d}.color.png", encode(scan.colour))
        put(folder / f"frame-{i:06d}.depth.png", encode(scan.raw))
        put(folder / f"frame-{i:06d}.pose.txt", rows(scan.world_T_scan))
    put(folder / "intrinsics.txt", rows(CAMERA))
    return folder


def write_scannet(folder: Path, scans: list[Sample] | None = None) -> Path:
    """Every tenth frame of an export, with cameras of its own for colour and depth."""
    scans = samples() if scans is None else scans
    for i, scan in enumerate(scans):
        put(folder / "color" / f"{10 * i}.jpg", encode(scan.colour, ".jpg"))
        put(folder / "depth" / f"{10 * i}.png", encode(scan.raw))
        put(folder / "pose" / f"{10 * i}.txt", rows(scan.world_T_scan))
    for what, image in (("depth", scans[0].raw), ("color", scans[0].colour)):
        camera = np.eye(4)
        camera[:3, :3] = camera_of_size(image.shape[1], image.shape[0])
        put(folder / "intrinsic" / f"intrinsic_{what}.txt", rows(camera))
        put(folder / "intrinsic" / f"extrinsic_{what}.txt", rows(np.eye(4)))
    return folder


def camera_of_size(width: int, height: int) -> Array:
    """`CAMERA` with its view resampled to another size."""
    sx, sy = width / WIDTH, height / HEIGHT
    scaled = np.diag([sx, sy, 1.0]) @ CAMERA
    scaled[0, 2] += 0.5 * sx - 0.5
    scaled[1, 2] += 0.5 * sy - 0.5
    return np.asarray(scaled)


def write_tum(folder: Path, scans: list[Sample] | None = None) -> Path:
    """Images a second apart, depth 10 ms after colour, poses at 100 Hz around each."""
    scans = samples(raw_per_metre=5000.0) if scans is None else scans
    lists: dict[str, list[str]] = {"rgb": [], "depth": [], "groundtruth": []}
    for i, scan in enumerate(scans):
        colour, depth = f"rgb/{100 + i}.000000.png", f"depth/{100 + i}.010000.png"
        put(folder / colour, encode(scan.colour))
        put(folder / depth, encode(scan.raw))
        lists["rgb"].append(f"{100 + i}.000000 {colour}")
        lists["depth"].append(f"{100 + i}.010000 {depth}")
        lists["groundtruth"] += [
            f"{100 + i + offset:.6f} " + tum_pose(se3.exp(drift) @ scan.world_T_scan)
            for offset, drift in ((0.001, np.full(6, 0.1)), (0.011, np.zeros(6)))
        ]
    for name, lines in lists.items():
        put(folder / f"{name}.txt", "# a comment\n" + "\n".join(lines) + "\n")
    put(folder / "intrinsics.txt", rows(CAMERA))
    return folder


def tum_pose(world_T_scan: Array) -> str:
    """``tx ty tz qx qy qz qw``, the quaternion from half the rotation vector."""
    omega = se3.rotation_log(world_T_scan[:3, :3])
    angle = float(np.linalg.norm(omega))
    axis = omega / angle if angle else omega
    values = [*world_T_scan[:3, 3], *(np.sin(angle / 2) * axis), np.cos(angle / 2)]
    return " ".join(repr(float(v)) for v in values)


def write_redwood(folder: Path, scans: list[Sample] | None = None) -> Path:
    """``color/ depth/ camera_intrinsic.json trajectory.log``."""
    scans = samples() if scans is None else scans
    for i, scan in enumerate(scans):
        put(folder / "color" / f"{i:05d}.jpg", encode(scan.colour, ".jpg"))
        put(folder / "depth" / f"{i:05d}.png", encode(scan.raw))
    put(folder / "camera_intrinsic.json", json.dumps(camera_json()))
    blocks = [f"{i} {i} {i + 1}\n{rows(scan.world_T_scan)}" for i, scan in enumerate(scans)]
    put(folder / "trajectory.log", "".join(blocks))
    return folder


@dataclass
class SensHeader:
    """The fields of a ``.sens`` header that tests change; None where the samples decide."""

    version: int = 4
    colour_kind: int = 1
    depth_kind: int = 1
    depth_size: tuple[int, int] | None = None
    shift: float = 1000.0
    frames: int | None = None
    depth_matrix: Array | None = None
    reference_T_depth: Array = field(default_factory=lambda: np.eye(4))


def sens_bytes(scans: list[Sample] | None = None, header: SensHeader | None = None) -> bytes:
    """A ``.sens`` file, version 4."""
    scans, header = samples() if scans is None else scans, header or SensHeader()
    name = b"StructureSensor"
    size = header.depth_size or scans[0].raw.shape[::-1]
    colour_size = scans[0].colour.shape[1::-1]
    colour_matrix, depth_matrix = np.eye(4), np.eye(4)
    colour_matrix[:3, :3] = camera_of_size(*colour_size)
    depth_matrix[:3, :3] = camera_of_size(*scans[0].raw.shape[::-1])
    matrices = (
        colour_matrix,
        np.eye(4),
        depth_matrix if header.depth_matrix is None else header.depth_matrix,
        header.reference_T_depth,
    )
    content = struct.pack("<IQ", header.version, len(name)) + name
    content += b"".join(m.astype("<f4").tobytes() for m in matrices)
    content += struct.pack("<2i4I", header.colour_kind, header.depth_kind, *colour_size, *size)
    count = len(scans) if header.frames is None else header.frames
    content += struct.pack("<fQ", header.shift, count)
    for scan in scans:
        colour = encode(scan.colour, ".jpg" if header.colour_kind == 2 else ".png")
        values = scan.raw.astype("<u2").tobytes()
        depth = zlib.compress(values) if header.depth_kind == 1 else values
        content += scan.world_T_scan.astype("<f4").tobytes()
        content += struct.pack("<4Q", 0, 0, len(colour), len(depth)) + colour + depth
    return content


def write_sens(folder: Path, scans: list[Sample] | None = None) -> Path:
    """A folder with one ``.sens`` file."""
    put(folder / "scene.sens", sens_bytes(scans))
    return folder


WRITERS: dict[str, Callable[[Path], Path]] = {
    "7scenes": write_seven_scenes,
    "scannet": write_scannet,
    "sens": write_sens,
    "tum": write_tum,
    "redwood": write_redwood,
}
"""One writer a layout, by the name that the reader gives it."""
