"""Training curves as a recording: one plot per figure, training and validation over the steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import rerun as rr

from fewview.errors import FewviewError

STEP = "step"


def record_curves(curves: Mapping[str, Sequence[Mapping[str, float]]], path: Path) -> None:
    """Write the points of curves to a Rerun recording.

    Args:
        curves: name of a curve (``training``, ``validation``) to its points, figures by name with
            their ``step`` among them.
        path: the .rrd file.

    Raises:
        FewviewError: the file cannot be written.
    """
    partial = path.with_name(f".{path.name}.part")
    stream = rr.RecordingStream("fewview train")
    try:
        stream.save(partial)
        for curve, points in curves.items():
            for point in points:
                stream.set_time(STEP, sequence=int(point[STEP]))
                for name, value in point.items():
                    if name != STEP:
                        stream.log(f"{curve}/{name}", rr.Scalars(value))
        stream.disconnect()
        partial.replace(path)
    except (OSError, RuntimeError) as error:
        partial.unlink(missing_ok=True)
        raise FewviewError(f"{path}: cannot be written; choose another --out") from error
