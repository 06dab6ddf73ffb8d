"""The observer that writes a Rerun recording of a run."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import rerun as rr

from fewview.errors import FewviewError
from fewview.recording import answer, layout, pictures, scene, tables, viewer
from fewview.recording.layout import Eye, RoomParts, Space, Step
from fewview.recording.pictures import Preview
from fewview.types import (
    ColouredMesh,
    CompletedScan,
    Frame,
    GlobalSolution,
    PairResult,
    ScanSet,
)


class Recorder:
    """Writes one recording of one run, to a file, to a live viewer, or to both.

    Use it as a context manager around the run and the saving of its results: the file gets its
    name when the block ends, and after an exception nothing of it remains.
    """

    def __init__(self, path: Path | None, view: bool) -> None:
        """Open the file and the viewer.

        Args:
            path: the .rrd file to write, or None.
            view: whether to show the run live in the Rerun viewer.

        Raises:
            FewviewError: the file cannot be written, or there is no viewer or display.
            ValueError: there is neither a file nor a viewer to record to.
        """
        if path is None and not view:
            raise ValueError("a recorder needs a file, a viewer or both")
        self._path = path
        self._part = path and path.with_name(f".{path.name}.{os.getpid()}.part")
        self._stream = rr.RecordingStream("fewview")
        self._stream.set_log_tick_enabled(False)
        self._open, self._live = True, view
        self._connect(view)
        self._names: tuple[str, ...] = ()
        self._previews: list[Preview] = []
        self._pairs: list[PairResult] = []
        self._spaces: list[Space] = []
        self._gallery: Eye | None = None
        self._shown: list[tuple[int, int]] = []
        self._rooms = RoomParts(0)
        self._answer = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(keep=kind is None)

    def started(self, scans: ScanSet) -> None:
        """Show what was read."""
        self._at(Step.INPUT)
        self._names = tuple(scan.name for scan in scans.scans)
        for root in (layout.world(0), layout.UNPLACED):
            self._stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        scene.log_text(self._stream, "summary", tables.inputs(scans))
        self.log(f"{len(self._names)} scans, {scans.format}")
        for note in scans.notes:
            self.log(note)
        if self._live:
            gallery = scene.gallery_eye(len(self._names))
            parts = (self._names, (), gallery, (), self._rooms)
            self._stream.send_blueprint(layout.blueprint(*parts))

    def scan_completed(self, index: int, frame: Frame, completed: CompletedScan) -> None:
        """Show a scan in a gallery of scans whose poses are not known yet."""
        self._at(Step.SCANS)
        scan = pictures.preview(frame, completed)
        self._previews.append(scan)
        self._rooms |= RoomParts.of(completed.room)
        scene.log_inputs(self._stream, scan.name, frame)
        scene.log_room_pictures(self._stream, scan.name, completed.room)
        place = scene.gallery_T_scan(index, scan.levelling)
        shelf = layout.path(layout.UNPLACED, scan.name)
        scene.log_points(self._stream, shelf, scan, place)
        scene.log_labels(self._stream, f"{shelf}/name", np.zeros((1, 3)), [scan.name])
        features = ", ".join(f"{len(f)} {kind}" for kind, f in completed.features.items())
        self.log(f"{scan.name}: {len(completed.patches)} planar patches, {features}")

    def pair_matched(self, result: PairResult) -> None:
        """Note how a pair went; its pictures follow when the candidates are chosen."""
        self._at(Step.PAIRS)
        self._pairs.append(result)
        best = max((c.probability for c in result.candidates), default=0.0)
        names = f"{self._names[result.source]} - {self._names[result.target]}"
        outcome = result.reason or f"{len(result.candidates)} candidates, best {best:.0%}"
        self.log(f"{names}: {outcome}")

    def solved(self, solution: GlobalSolution) -> None:
        """Move the scans from the gallery to their places and show what decided it."""
        self._at(Step.SOLVED)
        stream, scans = self._stream, self._previews
        pairs = solution.with_found(self._pairs)
        self._spaces = answer.log_components(stream, scans, pairs, solution)
        self._gallery = answer.log_unplaced(stream, scans, solution)
        self._shown = answer.log_pairs(stream, scans, pairs, solution)
        rooms = {scan.name: scan.room for scan in scans}
        self._answer = f"{tables.answer(solution)}\n\n{tables.rooms(rooms)}".rstrip()
        self.log(solution.headline)
        scene.log_text(self._stream, "summary", self._answer)
        scene.log_text(
            self._stream,
            "candidates",
            tables.candidates(layout.short(self._names), pairs, solution.selected),
        )
        if self._live:
            self._send_layout()

    def mesh_fused(self, component: int, mesh: ColouredMesh) -> None:
        """Show the mesh of a component and turn its view to it."""
        self._at(Step.MESH)
        root = layout.path(layout.world(component), "components", str(component), "mesh")
        scene.log_mesh(self._stream, root, mesh)
        if len(mesh.vertices):
            space = self._spaces[component]
            eye = layout.eye(mesh.vertices, space.centres)
            self._spaces[component] = replace(space, eye=eye)
        self.log(f"component {component}: mesh of {len(mesh.vertices)} vertices")

    def finished(self, timings_s: Mapping[str, float]) -> None:
        """Add the timings."""
        self._at(Step.DONE)
        scene.log_text(self._stream, "summary", f"{self._answer}\n\n{tables.timings(timings_s)}")
        for i, (stage, seconds) in enumerate(timings_s.items()):
            bar = rr.BarChart([seconds], abscissa=[i])
            self._stream.log(layout.path("timings", stage), bar)
        self.log(f"finished in {sum(timings_s.values()):.1f} s")
        self._send_layout()

    def close(self, keep: bool = True) -> None:
        """Give the file its name, or remove it; what comes later is not recorded."""
        if not self._open:
            return
        self._open = False
        self._stream.disconnect()
        if self._part is not None and self._path is not None:
            if keep:
                self._part.replace(self._path)
            else:
                self._part.unlink(missing_ok=True)

    def log(self, text: str) -> None:
        """Add a line to the log."""
        if self._open:
            self._stream.log("log", rr.TextLog(text, level=rr.TextLogLevel.INFO))

    def _connect(self, view: bool) -> None:
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if view:
            sinks.append(rr.GrpcSink(viewer.start()))
        if self._part is not None:
            sinks.append(rr.FileSink(self._part))
        try:
            self._stream.set_sinks(*sinks)
        except (OSError, RuntimeError, ValueError) as error:
            raise FewviewError(f"cannot write the recording {self._path}: {error}") from error

    def _send_layout(self) -> None:
        parts = (self._names, self._spaces, self._gallery, self._shown, self._rooms)
        self._stream.send_blueprint(layout.blueprint(*parts))

    def _at(self, step: Step) -> None:
        self._stream.set_time(layout.TIMELINE, sequence=step)
