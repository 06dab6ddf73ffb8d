"""From the candidates of all pairs to one consistent set of poses (Sec. 4.5 of the paper)."""

from fewview.global_stage.refine import refine
from fewview.global_stage.stage import solve

__all__ = ["refine", "solve"]
