"""The second representation of Sec. 3.2: a scan's room from above, completed."""

from fewview.completion.layout.complete import complete_layout
from fewview.completion.layout.network import LayoutNetwork
from fewview.completion.layout.points import ScanPoints, scan_points

__all__ = [
    "LayoutNetwork",
    "ScanPoints",
    "complete_layout",
    "scan_points",
]
