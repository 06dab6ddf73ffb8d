"""From evidence to a calibrated probability: a conditional logit over a pair's candidates.

Exactly one of K candidates is right, or none is: p_k = exp(z_k) / (1 + sum_j exp(z_j)) with
z = w . f + b + v . tanh(U f + c); the last term is for evidence that counts only beside other
evidence, such as where the cameras face when nothing that both have seen agrees. There is one model
for scans whose rooms were completed and one for scans as seen. Coefficients are fitted on
validation scenes by scripts/fit_probability.py and stored in weights/probability_completed.json and
probability_observed.json together with how they were made.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from fewview.types import Array

CLIP = 4.0
"""Evidence further from its mean, in standard deviations, says no more than this."""


@dataclass(frozen=True)
class ProbabilityModel:
    """A fitted conditional logit.

    Attributes:
        features: names of the evidence features, in order.
        mean, scale: (d,) standardisation.
        coefficients: (d,) w; intercept: b.
        inner: (h, d) U; inner_offsets: (h,) c; outer: (h,) v.
    """

    features: tuple[str, ...]
    mean: Array
    scale: Array
    coefficients: Array
    intercept: float
    inner: Array
    inner_offsets: Array
    outer: Array

    def standardised(self, evidence: Sequence[Mapping[str, float]]) -> Array:
        """(K, d) f of candidates described by named features; one that was not measured is as it
        is on average."""
        typical = dict(zip(self.features, self.mean, strict=True))
        rows = np.array([[e.get(name, typical[name]) for name in typical] for e in evidence])
        return self.standard(rows.reshape(len(evidence), len(self.features)))

    def standard(self, rows: Array) -> Array:
        """(K, d) f of (K, d) features as measured, in the order of `features`."""
        return np.clip((rows - self.mean) / self.scale, -CLIP, CLIP)

    def logits(self, evidence: Sequence[Mapping[str, float]]) -> Array:
        """(K,) z of candidates described by named features."""
        return self.logits_of(self.standardised(evidence))

    def logits_of(self, f: Array) -> Array:
        """(K,) z of (K, d) standardised features."""
        beside = np.tanh(f @ self.inner.T + self.inner_offsets) @ self.outer
        return np.asarray(f @ self.coefficients + self.intercept + beside)

    def probabilities(self, evidence: Sequence[Mapping[str, float]]) -> Array:
        """(K,) probabilities that each candidate is the right one; their sum is below one."""
        z = self.logits(evidence)
        shift = max(float(z.max(initial=0.0)), 0.0)
        weights = np.exp(z - shift)
        return np.asarray(weights / (np.exp(-shift) + weights.sum()))


ARRAYS = ("mean", "scale", "coefficients", "inner", "inner_offsets", "outer")
"""Names of a model's arrays, in memory as in the stored JSON."""


@cache
def shipped_model(completed: bool) -> ProbabilityModel:
    """The coefficients that come with the package, for completed rooms or for scans as seen."""
    name = f"probability_{'completed' if completed else 'observed'}.json"
    text = (resources.files("fewview") / "weights" / name).read_text()
    return from_dict(json.loads(text))


def from_dict(values: Mapping[str, object]) -> ProbabilityModel:
    """Build a model from the stored JSON."""
    names = values["features"]
    assert isinstance(names, list)
    arrays = {name: np.array(values[name], dtype=np.float64) for name in ARRAYS}
    return ProbabilityModel(features=tuple(names), intercept=number(values, "intercept"), **arrays)


def number(values: Mapping[str, object], name: str) -> float:
    """A number of the stored JSON."""
    value = values[name]
    assert isinstance(value, int | float)
    return float(value)
