"""Which rooms are for training and which are held out."""

from __future__ import annotations

from typing import Literal

from fewview.errors import FewviewError

Split = Literal["demo", "train", "validation", "test"]
_SPLITS: tuple[Split, ...] = ("demo", "train", "validation", "test")
_SEEDS_PER_SPLIT = 10**9


def split_seed(split: Split, index: int) -> int:
    """The room seed of a split's room number ``index``.

    Seeds below 10^9 are the demo's (so any small seed a user types is a demo room); train,
    validation and test follow in blocks of 10^9. No room is in two splits.

    Raises:
        FewviewError: the index is outside 0..10^9 - 1.
    """
    if not 0 <= index < _SEEDS_PER_SPLIT:
        raise FewviewError(f"room {index} does not exist; take 0 to {_SEEDS_PER_SPLIT - 1}")
    return _SPLITS.index(split) * _SEEDS_PER_SPLIT + index


def split_of(seed: int) -> Split:
    """The split of a room seed.

    Raises:
        FewviewError: no split has such a seed.
    """
    block = seed // _SEEDS_PER_SPLIT
    if not 0 <= block < len(_SPLITS):
        raise FewviewError(f"seed {seed} belongs to no split")
    return _SPLITS[block]
