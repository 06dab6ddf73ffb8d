"""One consistent set of camera poses and a mesh from a few RGB-D scans that hardly overlap.

import fewview
result = fewview.reconstruct(fewview.load("scans/"))
fewview.save(result, "mesh.ply")
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from fewview.config import Config
    from fewview.errors import ConfigError, FewviewError, PriorsError, ScanError
    from fewview.pipeline import match_two, reconstruct
    from fewview.report import save
    from fewview.scans import load

_HOMES = {
    "Config": "config",
    "ConfigError": "errors",
    "FewviewError": "errors",
    "PriorsError": "errors",
    "ScanError": "errors",
    "load": "scans",
    "match_two": "pipeline",
    "reconstruct": "pipeline",
    "save": "report",
}
__all__ = [
    "Config",
    "ConfigError",
    "FewviewError",
    "PriorsError",
    "ScanError",
    "load",
    "match_two",
    "reconstruct",
    "save",
]


def __getattr__(name: str) -> Any:
    """Public names are imported when first used, so that `import fewview` stays quick."""
    if name not in _HOMES:
        raise AttributeError(f"module 'fewview' has no attribute '{name}'")
    return getattr(importlib.import_module(f"fewview.{_HOMES[name]}"), name)
