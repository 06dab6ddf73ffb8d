"""From the pixels of a scan to its features (Sec. 3.2), and the networks that complete it.

The public names are imported when first used: training needs the networks without OpenCV.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fewview.completion.scan import KINDS, OBSERVED_KINDS, chosen_kinds, complete

__all__ = ["KINDS", "OBSERVED_KINDS", "chosen_kinds", "complete"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fewview.completion import scan

    return getattr(scan, name)
