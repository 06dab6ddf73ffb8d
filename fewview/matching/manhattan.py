"""The other yaws of a box-shaped room: candidates from levelled scans with a Manhattan frame.

Levelling leaves four yaws and a shift. For each yaw the shift is read off correlations of
top-down rasters: walls that face the same way should meet, and walls should not stand where the
other scan looked through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from fewview.geometry import se3
from fewview.types import Array, CompletedScan, FloatArray, Levelling

CELL_M = 0.12
HALF = 50
SIZE = 2 * HALF
PADDED = 2 * SIZE
WALL_COS = 0.35
FREE_BAND_M = (-0.7, 0.5)
FREE_MARGIN_M = 0.3
RAY_SAMPLES = 48
CONTRADICTION_WEIGHT = 0.5
PEAKS_PER_YAW = 2
PEAK_RADIUS = 4
HEIGHT_BIN_M = 0.05
HEIGHT_RANGE_M = 3.0
MAX_HEIGHT_SHIFT_M = 0.6


@dataclass(frozen=True)
class TopDown:
    """Top-down rasters of one levelled scan, camera in the middle.

    Attributes:
        walls: (4, S, S) float32, walls facing +x, +y, -x, -y.
        free: (S, S) float32, 1 where the scan looked through at body height.
        turned_spectra: (4, 5, P, P / 2 + 1) spectra of walls and free after each quarter turn.
        heights: (2, H) histogram of the heights of upward and downward faces.
    """

    walls: FloatArray
    free: FloatArray
    turned_spectra: np.ndarray
    heights: FloatArray


def top_down(scan: CompletedScan) -> TopDown:
    """Rasterise a scan in its level frame."""
    level = scan.levelling.level_R_scan.T
    points, normals = scan.surface.points @ level, scan.surface.normals @ level
    walls = _wall_raster(points, normals)
    free = _free_raster(points)
    free *= 1.0 - np.minimum(walls.sum(axis=0), 1.0)
    return TopDown(walls, free, _turned_spectra(walls, free), _height_histogram(points, normals))


def manhattan_poses(
    source: TopDown, target: TopDown, source_level: Levelling, target_level: Levelling
) -> list[tuple[Array, float]]:
    """Poses target_T_source and their raster scores, best first; none without two Manhattan frames.

    The score is the wall agreement less the contradictions, in cells.
    """
    if not (source_level.manhattan and target_level.manhattan):
        return []
    height = _height_shift(source, target, source_level, target_level)
    poses = []
    for yaw in range(4):
        for (x, y), score in _best_shifts(source.turned_spectra[yaw], target.turned_spectra[0]):
            angle = yaw * np.pi / 2
            turn = se3.rotation_exp(np.array([0.0, 0.0, angle]))
            rotation = target_level.level_R_scan.T @ turn @ source_level.level_R_scan
            shift = target_level.level_R_scan.T @ np.array([x, y, height])
            poses.append((se3.pose(rotation, shift), score))
    return sorted(poses, key=lambda pose: -pose[1])


def _cells(points: Array) -> tuple[np.ndarray, np.ndarray]:
    cells = np.rint(points[..., :2] / CELL_M).astype(int) + HALF
    inside = ((cells >= 0) & (cells < SIZE)).all(axis=-1)
    return cells, np.asarray(inside)


def _wall_raster(points: Array, normals: Array) -> FloatArray:
    walls = np.zeros((4, SIZE, SIZE), dtype=np.float32)
    cells, inside = _cells(points)
    upright = inside & (np.abs(normals[:, 2]) < WALL_COS)
    facing = np.rint(np.arctan2(normals[:, 1], normals[:, 0]) / (np.pi / 2)).astype(int) % 4
    np.add.at(walls, (facing[upright], cells[upright, 0], cells[upright, 1]), 1.0)
    blurred = ndimage.gaussian_filter(np.sqrt(walls), (0, 0.8, 0.8), mode="constant")
    return np.asarray(blurred, dtype=np.float32)


def _free_raster(points: Array) -> FloatArray:
    """Cells that rays cross at body height before they come near their end."""
    reach = np.linalg.norm(points, axis=1)
    shares = (np.arange(RAY_SAMPLES) + 0.5) / RAY_SAMPLES
    usable = np.maximum(1.0 - FREE_MARGIN_M / np.maximum(reach, 1e-6), 0.0)
    samples = points[:, None] * (usable[:, None] * shares[None])[..., None]
    cells, inside = _cells(samples)
    inside &= (samples[..., 2] > FREE_BAND_M[0]) & (samples[..., 2] < FREE_BAND_M[1])
    count = np.zeros((SIZE, SIZE), dtype=np.float32)
    np.add.at(count, (cells[inside][:, 0], cells[inside][:, 1]), 1.0)
    return (count > 2.0).astype(np.float32)


def _turned_spectra(walls: FloatArray, free: FloatArray) -> np.ndarray:
    spectra = []
    for turns in range(4):
        channels = np.concatenate([np.roll(walls, turns, axis=0), free[None]])
        spectra.append(fft.rfft2(_turned(channels, turns), (PADDED, PADDED)))
    return np.stack(spectra)


def _turned(channels: FloatArray, turns: int) -> FloatArray:
    """Rasters after a counter-clockwise turn of the scan about its camera at cell (HALF, HALF)."""
    out = channels
    for _ in range(turns):
        flipped = np.zeros_like(out)
        flipped[:, 1:, :] = out.transpose(0, 2, 1)[:, :0:-1, :]
        out = flipped
    return out


def _best_shifts(source: np.ndarray, target: np.ndarray) -> list[tuple[tuple[float, float], float]]:
    """Shifts in metres with the highest score, and their scores."""
    back = np.conj(source)
    agreement = (back[:4] * target[:4]).sum(axis=0)
    contradiction = back[:4].sum(axis=0) * target[4] + back[4] * target[:4].sum(axis=0)
    score = fft.irfft2(agreement - CONTRADICTION_WEIGHT * contradiction, (PADDED, PADDED))
    found = []
    for _ in range(PEAKS_PER_YAW):
        i, j = np.unravel_index(int(score.argmax()), score.shape)
        found.append(((_shift(int(i)), _shift(int(j))), float(score[i, j])))
        rows = np.arange(i - PEAK_RADIUS, i + PEAK_RADIUS + 1) % PADDED
        columns = np.arange(j - PEAK_RADIUS, j + PEAK_RADIUS + 1) % PADDED
        score[np.ix_(rows, columns)] = -np.inf
    return found


def _shift(index: int) -> float:
    return CELL_M * (index if index < SIZE else index - PADDED)


def _height_histogram(points: Array, normals: Array) -> FloatArray:
    bins = np.arange(-HEIGHT_RANGE_M, HEIGHT_RANGE_M + HEIGHT_BIN_M / 2, HEIGHT_BIN_M)
    up = np.histogram(points[normals[:, 2] > 0.9, 2], bins)[0]
    down = np.histogram(points[normals[:, 2] < -0.9, 2], bins)[0]
    smooth = ndimage.gaussian_filter1d(np.stack([up, down]).astype(np.float32), 1.0, axis=1)
    return np.asarray(np.sqrt(smooth))


def _height_shift(
    source: TopDown, target: TopDown, source_level: Levelling, target_level: Levelling
) -> float:
    """What is added to heights in the source's level frame to get the target's."""
    if source_level.floor_z is not None and target_level.floor_z is not None:
        return target_level.floor_z - source_level.floor_z
    steps = round(MAX_HEIGHT_SHIFT_M / HEIGHT_BIN_M)
    width = source.heights.shape[1]
    scores = []
    for step in range(-steps, steps + 1):
        a = source.heights[:, max(0, -step) : width - max(0, step)]
        b = target.heights[:, max(0, step) : width - max(0, -step)]
        scores.append(float((a * b).sum()) - 1e-3 * abs(step))
    return (int(np.argmax(scores)) - steps) * HEIGHT_BIN_M
