"""The completion networks with the weights of some folders."""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from torch import nn

from fewview import weights
from fewview.completion.layout.complete import complete_layout
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig
from fewview.completion.layout.points import ScanPoints
from fewview.completion.panorama.complete import complete_ring
from fewview.completion.panorama.network import PanoramaNetwork, PanoramaNetworkConfig
from fewview.completion.room import NETWORKS
from fewview.completion.structure.complete import complete_planes
from fewview.completion.structure.network import StructureNetwork, StructureNetworkConfig
from fewview.types import CompletedRoom, RingScan

MAKERS: Mapping[str, Callable[[Mapping[str, Any]], nn.Module]] = {
    "panorama": lambda size: PanoramaNetwork(PanoramaNetworkConfig(**size)),
    "layout": lambda size: LayoutNetwork(LayoutNetworkConfig(**size)),
    "structure": lambda size: StructureNetwork(StructureNetworkConfig(**size)),
}


@dataclass(frozen=True)
class Networks:
    """Which networks are measured, and where their weights are: (name, folder) each."""

    folders: tuple[tuple[str, Path], ...]

    @staticmethod
    def found(folders: Sequence[Path]) -> Networks:
        """Each network of the first folder that has it.

        Raises:
            SystemExit: none of the folders has any.
        """
        holding = {
            name: [f for f in folders if (f / f"{name}.safetensors").is_file()] for name in NETWORKS
        }
        found = tuple((name, of_name[0].resolve()) for name, of_name in holding.items() if of_name)
        if not found:
            raise SystemExit(f"no weights in {', '.join(map(str, folders))}")
        return Networks(found)

    @property
    def names(self) -> tuple[str, ...]:
        """Of `NETWORKS`."""
        return tuple(name for name, _ in self.folders)

    @property
    def key(self) -> str:
        """Twelve hex digits that change with the weights."""
        hashes = [_card(name, folder)["sha256"] for name, folder in self.folders]
        return hashlib.sha256(" ".join([*self.names, *hashes]).encode()).hexdigest()[:12]

    def cards(self) -> dict[str, dict[str, Any]]:
        """What is known of each network's weights."""
        shown = ("sha256", "steps", "hours", "hardware", "data", "validation", "note")
        cards = {name: _card(name, folder) for name, folder in self.folders}
        return {n: {k: card[k] for k in shown if k in card} for n, card in cards.items()}

    def complete(self, ring: RingScan, points: ScanPoints) -> CompletedRoom:
        """What the networks make of a scan on its ring and of points drawn from it."""
        panorama = cast(PanoramaNetwork | None, self.network("panorama"))
        layout = cast(LayoutNetwork | None, self.network("layout"))
        structure = cast(StructureNetwork | None, self.network("structure"))
        return CompletedRoom(
            ring,
            None if panorama is None else complete_ring(ring, panorama),
            None if layout is None else complete_layout(ring, points, layout),
            None if structure is None else complete_planes(points, structure),
        )

    def network(self, name: str) -> nn.Module | None:
        """One of `NETWORKS`, None where there are no weights of it."""
        folder = dict(self.folders).get(name)
        return None if folder is None else _network(name, folder, _card(name, folder)["sha256"])


def add_networks(parser: argparse.ArgumentParser) -> None:
    """The option that says where the weights are."""
    parser.add_argument(
        "--networks",
        nargs="+",
        type=Path,
        default=[weights.FOLDER],
        metavar="DIR",
        help="folders with weights (NAME.safetensors and NAME.json), by default the package's",
    )


def _card(name: str, folder: Path) -> dict[str, Any]:
    return cast(dict[str, Any], json.loads((folder / f"{name}.json").read_text()))


@lru_cache(6)
def _network(name: str, folder: Path, _: str) -> nn.Module:
    """The network as it was when its weights had the hash that is given last."""
    state, card = weights.load(name, folder)
    network = MAKERS[name](card["config"]["settings"]["size"])
    network.load_state_dict(state)
    return network.eval()
