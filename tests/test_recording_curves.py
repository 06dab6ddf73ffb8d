"""Training curves as a recording."""

from __future__ import annotations

from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from fewview.errors import FewviewError
from fewview.recording import record_curves

CURVES = {
    "training": [{"step": 10, "loss": 2.0, "normal": 0.5}, {"step": 20, "loss": 1.5}],
    "validation": [{"step": 20, "loss": 1.75}],
}


def test_every_figure_is_a_plot_over_the_steps(tmp_path: Path) -> None:
    record_curves(CURVES, tmp_path / "curves.rrd")
    found: dict[str, list[tuple[int, float]]] = {}
    for chunk in RrdReader(tmp_path / "curves.rrd").stream():
        table = chunk.to_record_batch()
        if "step" in table.schema.names:
            values = [v[0] for v in table.column("Scalars:scalars").to_pylist()]
            steps = table.column("step").to_pylist()
            found.setdefault(chunk.entity_path.lstrip("/"), []).extend(
                zip(steps, values, strict=True)
            )
    assert {name: sorted(points) for name, points in found.items()} == {
        "training/loss": [(10, 2.0), (20, 1.5)],
        "training/normal": [(10, 0.5)],
        "validation/loss": [(20, 1.75)],
    }
    assert [file.name for file in tmp_path.iterdir()] == ["curves.rrd"]


def test_unwritable_curves_are_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(FewviewError, match="cannot be written"):
        record_curves(CURVES, tmp_path / "none" / "curves.rrd")
