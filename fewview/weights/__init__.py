"""Weights that come with the package: NAME.safetensors beside NAME.json, its card.

A card says what the weights were trained on, for how long, how well they do, and their SHA-256.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from safetensors import SafetensorError
from safetensors.torch import load as read_tensors
from safetensors.torch import save as to_bytes
from torch import Tensor, nn

from fewview.errors import FewviewError

FOLDER = Path(__file__).parent
Network = TypeVar("Network", bound=nn.Module)


def folder_of(setting: str) -> Path:
    """The folder that a setting names, that of the package where it is empty."""
    return Path(setting) if setting else FOLDER


def load(name: str, folder: Path = FOLDER) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """The state dict and the card of a network.

    Raises:
        FewviewError: a file is missing, unreadable, or not the one that its card describes.
    """
    data_path, card_path = folder / f"{name}.safetensors", folder / f"{name}.json"
    for path in (data_path, card_path):
        if not path.is_file():
            raise FewviewError(f"{path}: no such weights; train them (fewview train) or reinstall")
    data = data_path.read_bytes()
    try:
        card = json.loads(card_path.read_text())
        expected = card["sha256"]
    except (ValueError, KeyError, TypeError) as error:
        raise FewviewError(f"{card_path}: is not a card of weights; reinstall fewview") from error
    if hashlib.sha256(data).hexdigest() != expected:
        raise FewviewError(f"{data_path}: is not what {card_path.name} describes; reinstall")
    try:
        return read_tensors(data), card
    except SafetensorError as error:
        raise FewviewError(f"{data_path}: is damaged; reinstall fewview") from error


def shipped(
    name: str, make: Callable[[Mapping[str, Any]], Network], folder: Path = FOLDER
) -> Network:
    """A network with the weights that come with the package, ready to predict.

    Args:
        name: of the weights.
        make: builds the network from the sizes that its card holds.
        folder: where the weights are, when they are not those of the package.

    Raises:
        FewviewError: the weights are missing or damaged.
    """
    state, card = load(name, folder)
    network = make(card["config"]["settings"]["size"])
    network.load_state_dict(state)
    return network.eval()


def save(name: str, folder: Path, state: dict[str, Tensor], card: dict[str, Any]) -> None:
    """Write weights and their card, which gets their SHA-256; each file whole or not at all."""
    contiguous = {key: tensor.detach().cpu().contiguous() for key, tensor in state.items()}
    data = to_bytes(contiguous)
    card = {**card, "sha256": hashlib.sha256(data).hexdigest()}
    _write(folder / f"{name}.safetensors", data)
    _write(folder / f"{name}.json", (json.dumps(card, indent=1, allow_nan=False) + "\n").encode())


def _write(path: Path, data: bytes) -> None:
    partial = path.with_suffix(path.suffix + ".part")
    partial.write_bytes(data)
    partial.replace(path)
