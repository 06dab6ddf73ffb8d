"""What the user knows beforehand of scans and pairs, read from a file and put into a run."""

from fewview.priors.file import load
from fewview.priors.known import PairPrior, Priors

__all__ = ["PairPrior", "Priors", "load"]
