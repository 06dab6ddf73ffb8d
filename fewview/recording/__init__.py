"""One Rerun recording a run: how the answer came about. The only place that imports rerun."""

from fewview.recording.recorder import Recorder
from fewview.recording.viewer import view

__all__ = ["Recorder", "view"]
