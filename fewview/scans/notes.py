"""What was assumed about scans, told in one line a kind however many scans it holds for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_NAMED = 3


@dataclass(frozen=True)
class Remark:
    """Something assumed about one scan: remarks of equal text make one line.

    Attributes:
        text: what was done.
        detail: what differs from scan to scan, such as image sizes.
    """

    text: str
    detail: str


def some(names: Sequence[str]) -> str:
    """The first few names, and how many more there are."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def lines(remarks: Mapping[str, Sequence[Remark]]) -> list[str]:
    """One line a kind of remark, in the order of their first appearance.

    Args:
        remarks: by scan name, of all scans; those that a remark does not hold for all are named.
    """
    texts = dict.fromkeys(remark.text for found in remarks.values() for remark in found)
    return [_line(text, remarks) for text in texts]


def _line(text: str, remarks: Mapping[str, Sequence[Remark]]) -> str:
    names = [name for name, found in remarks.items() if any(r.text == text for r in found)]
    details = [r.detail for found in remarks.values() for r in found if r.text == text]
    line = f"{text} ({some(list(dict.fromkeys(details)))})"
    return line if len(names) == len(remarks) else f"{line}: {some(names)}"
