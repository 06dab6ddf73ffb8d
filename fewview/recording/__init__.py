"""One Rerun recording a run: how the answer came about, or how training went. The only place that
imports rerun."""

from fewview.recording.curves import record_curves
from fewview.recording.recorder import Recorder
from fewview.recording.viewer import view

__all__ = ["Recorder", "record_curves", "view"]
