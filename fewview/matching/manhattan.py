"""The other yaws of a box-shaped room: candidates from levelled scans with a Manhattan frame.

Levelling leaves four yaws and a shift. For each yaw the shift is read off correlations of
top-down rasters: upright faces that look the same way at the same height should meet, table tops
should meet, and nothing should stand where the other scan looked through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from fewview.completion.room_matches import floor_height
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
WALL_BANDS_M = (0.9, 1.8)
TOP_BANDS_M = (0.3, 0.62, 0.95, 1.5)
DEFAULT_CAMERA_HEIGHT_M = 1.45
BLUR_CELLS = 0.8
CONTRADICTION_WEIGHT = 2.0
PEAKS_PER_YAW = 3
MAX_POSES = 6
PEAK_RADIUS = 3


@dataclass(frozen=True)
class TopDown:
    """Top-down rasters of one levelled scan, camera in the middle.

    Attributes:
        turned_spectra: (4, C + 2, P, P / 2 + 1) spectra after each quarter turn of C channels of
            faces, of all upright faces together, and of the space the scan looked through.
    """

    turned_spectra: np.ndarray


def top_down(scan: CompletedScan) -> TopDown:
    """Rasterise a scan in its level frame."""
    level = scan.levelling.level_R_scan.T
    points, normals = scan.surface.points @ level, scan.surface.normals @ level
    floor_z = floor_height(scan)
    heights = points[:, 2] - (-DEFAULT_CAMERA_HEIGHT_M if floor_z is None else floor_z)
    walls, tops = _wall_raster(points, normals, heights), _top_raster(points, normals, heights)
    free = _free_raster(points)
    free *= 1.0 - np.minimum(walls.sum(axis=(0, 1)), 1.0)
    return TopDown(_turned_spectra(walls, tops, free))


def manhattan_poses(
    source: TopDown,
    target: TopDown,
    source_level: Levelling,
    target_level: Levelling,
    source_lift: float,
) -> list[tuple[Array, float]]:
    """Poses target_T_source and their raster scores, best first; none without two Manhattan frames.

    The score is the wall agreement less the contradictions, in cells; for ``source_lift`` see
    `heights.lift`.
    """
    if not (source_level.manhattan and target_level.manhattan):
        return []
    poses = []
    for yaw in range(4):
        for (x, y), score in _best_shifts(source.turned_spectra[yaw], target.turned_spectra[0]):
            angle = yaw * np.pi / 2
            turn = se3.rotation_exp(np.array([0.0, 0.0, angle]))
            rotation = target_level.level_R_scan.T @ turn @ source_level.level_R_scan
            shift = target_level.level_R_scan.T @ np.array([x, y, source_lift])
            poses.append((se3.pose(rotation, shift), score))
    return sorted(poses, key=lambda pose: -pose[1])[:MAX_POSES]


def _cells(points: Array) -> tuple[np.ndarray, np.ndarray]:
    cells = np.rint(points[..., :2] / CELL_M).astype(int) + HALF
    inside = ((cells >= 0) & (cells < SIZE)).all(axis=-1)
    return cells, np.asarray(inside)


def _wall_raster(points: Array, normals: Array, heights: Array) -> FloatArray:
    """(4, bands, S, S) upright faces looking along +x, +y, -x, -y, by height band."""
    walls = np.zeros((4, len(WALL_BANDS_M) + 1, SIZE, SIZE), dtype=np.float32)
    cells, inside = _cells(points)
    upright = inside & (np.abs(normals[:, 2]) < WALL_COS)
    facing = np.rint(np.arctan2(normals[:, 1], normals[:, 0]) / (np.pi / 2)).astype(int) % 4
    band = np.digitize(heights, WALL_BANDS_M)
    x, y = cells[upright].T
    np.add.at(walls, (facing[upright], band[upright], x, y), 1.0)
    return _blurred(walls)


def _top_raster(points: Array, normals: Array, heights: Array) -> FloatArray:
    """(bands, S, S) faces that look up: seats and tables, shelves and counters."""
    tops = np.zeros((len(TOP_BANDS_M) - 1, SIZE, SIZE), dtype=np.float32)
    cells, inside = _cells(points)
    band = np.digitize(heights, TOP_BANDS_M) - 1
    use = inside & (normals[:, 2] > 0.9) & (band >= 0) & (band < len(tops))
    np.add.at(tops, (band[use], *cells[use].T), 1.0)
    return _blurred(tops)


def _blurred(counts: FloatArray) -> FloatArray:
    sigma = (0.0,) * (counts.ndim - 2) + (BLUR_CELLS, BLUR_CELLS)
    blurred = ndimage.gaussian_filter(np.sqrt(counts), sigma, mode="constant")
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


def _turned_spectra(walls: FloatArray, tops: FloatArray, free: FloatArray) -> np.ndarray:
    spectra = []
    for turns in range(4):
        faces = np.roll(walls, turns, axis=0).reshape(-1, SIZE, SIZE)
        channels = np.concatenate([faces, tops, walls.sum(axis=(0, 1))[None], free[None]])
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
    agreement = np.einsum("cij,cij->ij", back[:-2], target[:-2])
    contradiction = back[-2] * target[-1] + back[-1] * target[-2]
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
