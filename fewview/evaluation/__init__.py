"""The evaluation protocol; nothing that estimates a pose may import it."""

from fewview.evaluation.report import evaluate_report
from fewview.evaluation.text import text

__all__ = ["evaluate_report", "text"]
