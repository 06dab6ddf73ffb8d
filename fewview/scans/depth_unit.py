"""Which length a raw depth value stands for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fewview.errors import ScanError
from fewview.types import FloatArray

MILLIMETRE = 0.001
UNITS = {MILLIMETRE: "1/1000 m", 1 / 5000: "1/5000 m", 1 / 10000: "1/10000 m", 1 / 4000: "1/4000 m"}
"""The units that depth cameras and data sets use, the most common first."""

PLAUSIBLE_M = (0.3, 15.0)
USUAL_M = (0.5, 6.0)
_NO_MEASUREMENT = 65535


@dataclass(frozen=True)
class DepthUnit:
    """Metres per raw value, why we think so, and what is odd about it (or None)."""

    metres: float
    reason: str
    warning: str | None = None


def to_metres(raw: NDArray[np.uint16], unit_m: float) -> FloatArray:
    """(H, W) raw values to metres; 0 where nothing was measured (0 or 65535)."""
    valid = raw != _NO_MEASUREMENT
    return np.where(valid, raw * np.float32(unit_m), np.float32(0.0)).astype(np.float32)


def median_raw(raw: NDArray[np.uint16], label: str) -> float:
    """The median of the measured raw values.

    Raises:
        ScanError: the image holds no measurement.
    """
    measured = raw[(raw > 0) & (raw != _NO_MEASUREMENT)]
    if measured.size == 0:
        raise ScanError(f"{label} is empty (no pixel has a depth): remove this scan")
    return float(np.median(measured))


def given(unit_m: float, median: float) -> DepthUnit:
    """The unit that the user asks for, with a warning when it makes odd distances.

    Raises:
        ScanError: not a positive number.
    """
    if not 0.0 < unit_m < np.inf:
        raise ScanError(f"depth unit {unit_m} must be a positive number of metres, such as 0.001")
    return DepthUnit(unit_m, "given", _oddness(median * unit_m))


def detect(declared: DepthUnit, median: float, folder: str) -> DepthUnit:
    """The declared unit if it gives distances of rooms, else the first well-known one that does.

    Args:
        declared: what the layout or its files say.
        median: median raw value over a few scans.
        folder: names the scans in messages.

    Raises:
        ScanError: no unit makes sense of the values.
    """
    if _within(median * declared.metres, PLAUSIBLE_M):
        return DepthUnit(declared.metres, declared.reason, _oddness(median * declared.metres))
    for metres, name in UNITS.items():
        if _within(median * metres, PLAUSIBLE_M):
            warning = (
                f"depth unit: {declared.metres:g} m ({declared.reason}) would make the median "
                f"depth {median * declared.metres:.3g} m; {name} makes it {median * metres:.2f} m"
            )
            return DepthUnit(metres, f"{name}, guessed from the values", warning)
    raise ScanError(
        f"{folder}: the median raw depth is {median:g}, which no known unit turns into the size of "
        "a room: export depth as 16-bit PNG in millimetres"
    )


def _within(value: float, bounds: tuple[float, float]) -> bool:
    return bounds[0] <= value <= bounds[1]


def _oddness(median_m: float) -> str | None:
    if _within(median_m, USUAL_M):
        return None
    return f"the median depth is {median_m:.2f} m, unusual for a room: check the depth unit"
