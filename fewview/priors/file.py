"""The priors file: YAML (and so JSON) that speaks of scans by their names.

    up: {a: [0, -1, 0], "*": [0, -1, 0.2]}   # or one direction for all scans: up: [0, -1, 0]
    poses: {a: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
    pairs:
      - {source: a, target: b, target_T_source: [[...], [...], [...], [0, 0, 0, 1]]}
      - {source: a, target: c, pin: 2}
      - {source: b, target: c, veto: [0, 1]}   # or veto: all

Scalars are read as text, so that a scan named 000010 keeps its name.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
import yaml

from fewview.errors import PriorsError
from fewview.geometry import se3
from fewview.priors.known import PairPrior, Priors
from fewview.types import Array

ALL_OTHERS = "*"
"""Stands for every scan whose up direction is not given by name."""

ROUNDING = 1e-3
"""How far the last row and R^T R of a written motion may be off."""


def load(path: Path, names: Sequence[str], top_k: int | None = None) -> Priors:
    """Read what the user knows of the scans ``names``.

    Args:
        path: the file.
        names: of all scans, in the order of the run.
        top_k: candidates a pair that the run keeps at most; tells early that a rank is too high.

    Raises:
        PriorsError: the file cannot be read, names something unknown, holds values of the wrong
            kind, or contradicts itself.
    """
    try:
        values = yaml.load(path.read_text(), _TextLoader)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise PriorsError(f"{path}: not a readable YAML file ({_reason(error)})") from error
    return _File(path, tuple(names), top_k).priors(values or {})


def _reason(error: Exception) -> str:
    """What went wrong, and in which line of the file."""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        return f"line {error.problem_mark.line + 1}: {error.problem}"
    return str(error).splitlines()[0]


class _TextLoader(yaml.BaseLoader):
    """Leaves every scalar the text that it is, and refuses keys that come twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [key.value for key, _ in node.value]
        if twice := [key for i, key in enumerate(keys) if key in keys[:i]]:
            raise yaml.constructor.ConstructorError(
                None, None, f"'{twice[0]}' comes twice", node.start_mark
            )
        return super().construct_mapping(node, deep)


@dataclass(frozen=True)
class _File:
    """The file being read and the scans that it may speak of."""

    path: Path
    names: tuple[str, ...]
    top_k: int | None

    def priors(self, values: Any) -> Priors:
        """All of it."""
        parts = self._mapping(values, "the file", ("up", "poses", "pairs"))
        poses = {
            self._scan(name, "poses"): self._rigid(value, f"poses: {name}")
            for name, value in self._mapping(parts.get("poses", {}), "poses").items()
        }
        pairs: dict[tuple[int, int], PairPrior] = {}
        for where, key, prior in self._pairs(parts.get("pairs", [])):
            if key in pairs:
                self._refuse(f"{where} comes twice; write one entry")
            if poses.keys() >= set(key):
                self._refuse(f"{where} is settled by its two fixed poses; leave it out")
            pairs[key] = prior
        return Priors(self.names, self._up(parts.get("up", {})), poses, pairs)

    def _up(self, value: Any) -> dict[int, Array]:
        """Unit up directions by scan."""
        named = self._mapping({ALL_OTHERS: value} if isinstance(value, list) else value, "up")
        directions = {name: self._direction(value, name) for name, value in named.items()}
        others = directions.pop(ALL_OTHERS, None)
        everyone = {} if others is None else dict.fromkeys(range(len(self.names)), others)
        return everyone | {self._scan(name, "up"): up for name, up in directions.items()}

    def _pairs(self, entries: Any) -> Iterator[tuple[str, tuple[int, int], PairPrior]]:
        """Title for messages, (source, target) with source < target, and prior of every entry."""
        if not isinstance(entries, list):
            self._refuse("'pairs' must be a list of entries {source: a, target: b, ...}")
        for number, entry in enumerate(entries):
            where = f"pairs, entry {number + 1}"
            known = ("source", "target", "target_T_source", "pin", "veto")
            values = self._mapping(entry, where, known)
            if missing := {"source", "target"} - values.keys():
                self._refuse(f"{where}: '{min(missing)}' is missing")
            source, target = (self._scan(values[end], where) for end in ("source", "target"))
            if source == target:
                self._refuse(f"{where}: a pair needs two different scans")
            where += f" ({values['source']} - {values['target']})"
            yield (
                where,
                (min(source, target), max(source, target)),
                self._pair(values, source > target, where),
            )

    def _pair(self, values: Mapping[str, Any], swapped: bool, where: str) -> PairPrior:
        """What an entry says, of the pair in the order of the scans."""
        if values.keys() <= {"source", "target"}:
            self._refuse(f"{where}: says nothing; add target_T_source, pin or veto")
        if {"target_T_source", "pin"} <= values.keys():
            self._refuse(f"{where}: give target_T_source or pin, not both")
        motion = None
        if "target_T_source" in values:
            motion = se3.rigid(self._rigid(values["target_T_source"], f"{where}: target_T_source"))
            motion = se3.inverse(motion) if swapped else motion
        pin = self._rank(values["pin"], f"{where}: pin") if "pin" in values else None
        veto = self._veto(values.get("veto", []), f"{where}: veto")
        if pin is not None and (veto == "all" or pin in veto):
            self._refuse(f"{where}: rank {pin} is both pinned and vetoed")
        return PairPrior(motion, pin, veto)

    def _veto(self, value: Any, where: str) -> frozenset[int] | Literal["all"]:
        if value == "all":
            return "all"
        if not isinstance(value, list):
            self._refuse(f"{where} must be a list of ranks, or all")
        return frozenset(self._rank(rank, where) for rank in value)

    def _rank(self, value: Any, where: str) -> int:
        if not isinstance(value, str) or not value.isdecimal():
            self._refuse(f"{where} must hold ranks: whole numbers from 0 up, as in the report")
        if self.top_k is not None and int(value) >= self.top_k:
            self._refuse(
                f"{where}: there is no rank {value}; this run keeps {self.top_k} candidates a "
                "pair, from rank 0 up (--top-k)"
            )
        return int(value)

    def _scan(self, name: Any, where: str) -> int:
        if name in self.names:
            return self.names.index(name)
        near = difflib.get_close_matches(str(name), self.names, n=1)
        hint = f"did you mean '{near[0]}'? " if near else ""
        shown = ", ".join(self.names[:8]) + (" ..." if len(self.names) > 8 else "")
        self._refuse(f"{where}: there is no scan '{name}'; {hint}there are {shown}")

    def _direction(self, value: Any, name: str) -> Array:
        direction = self._numbers(value, (3,), f"up: {name}")
        length = np.linalg.norm(direction)
        if length == 0.0:
            self._refuse(f"up: {name}: a direction cannot be zero")
        return np.asarray(direction / length)

    def _rigid(self, value: Any, where: str) -> Array:
        """A (4, 4) rigid motion, as written."""
        matrix = self._numbers(value, (4, 4), where)
        rotation = matrix[:3, :3]
        if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > ROUNDING:
            self._refuse(f"{where}: the last row must be 0 0 0 1; write the matrix row by row")
        if np.abs(rotation.T @ rotation - np.eye(3)).max() > ROUNDING:
            self._refuse(
                f"{where}: no rigid motion, its rotation is not orthonormal; scale it "
                "back to metres, or give more digits"
            )
        if np.linalg.det(rotation) < 0.0:
            self._refuse(
                f"{where}: no rigid motion but a mirror; axes are x right, y down, z forward"
            )
        return matrix

    def _numbers(self, value: Any, shape: tuple[int, ...], where: str) -> Array:
        try:
            numbers = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != shape or not np.isfinite(numbers).all():
            size = " x ".join(str(n) for n in shape)
            self._refuse(f"{where} must be {size} finite numbers")
        return numbers

    def _mapping(
        self, value: Any, where: str, known: Collection[str] | None = None
    ) -> Mapping[str, Any]:
        """A mapping with text as keys, all of them ``known`` ones."""
        if not isinstance(value, dict):
            self._refuse(f"{where} must hold named values")
        for key in value:
            if known is not None and key not in known:
                self._refuse(f"{where}: unknown key '{key}'; there are {', '.join(known)}")
        return value

    def _refuse(self, message: str) -> NoReturn:
        raise PriorsError(f"{self.path}: {message}")
