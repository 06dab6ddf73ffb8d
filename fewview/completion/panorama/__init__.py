"""360-image completion: a scan's surroundings on a ring of four faces (Sec. 3.2)."""

from fewview.completion.panorama.complete import complete_ring, shipped_network
from fewview.completion.panorama.network import (
    CLASSES,
    PanoramaNetwork,
    PanoramaNetworkConfig,
    RingPrediction,
    network_input,
)
from fewview.completion.panorama.ring import (
    heading_frame,
    project_scan,
    ring_normals,
    ring_pixels,
    ring_points,
    ring_rays,
)
from fewview.completion.panorama.walls import scan_ring

__all__ = [
    "CLASSES",
    "PanoramaNetwork",
    "PanoramaNetworkConfig",
    "RingPrediction",
    "complete_ring",
    "heading_frame",
    "network_input",
    "project_scan",
    "ring_normals",
    "ring_pixels",
    "ring_points",
    "ring_rays",
    "scan_ring",
    "shipped_network",
]
