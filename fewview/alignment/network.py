"""The aligner: what each cell of a drawing says of the other scan's, for all shifts at once.

Every scan is embedded once, with one set of channels as a target and one for each yaw as a source.
The logit of a yaw and a shift is the sum over all cells of the products of the channels that then
meet: a correlation, which a Fourier transform gives for every shift. All poses that are not the
true one are negatives of the training pair.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fewview.alignment.drawing import CHANNELS
from fewview.completion.layout.grid import CELL_M, CELLS, location_channels
from fewview.completion.layout.unet import EncoderDecoder

YAWS = 4
COARSE = 2
GRID = CELLS // COARSE
STEP_M = CELL_M * COARSE
SHIFTS = 2 * GRID
LOCATION = 3
INITIAL_SCALE = 0.003


@dataclass(frozen=True)
class AlignerNetworkConfig:
    """Size of the network."""

    width: int = 32
    """Channels of the encoder-decoder at full size, a multiple of 8."""
    channels: int = 24
    """Length of a cell's embedding, for each yaw as a source and as a target."""


class Spectra(NamedTuple):
    """Fourier transforms of the embeddings of B drawings.

    Attributes:
        source: (B, YAWS, C, SHIFTS, SHIFTS / 2 + 1) complex, already turned by each yaw.
        target: (B, C, SHIFTS, SHIFTS / 2 + 1) complex.
    """

    source: Tensor
    target: Tensor


class AlignerNetwork(nn.Module):
    """Embeds drawings; `logits` of two embeddings is a map over yaws and shifts."""

    centres: Tensor

    def __init__(self, config: AlignerNetworkConfig = AlignerNetworkConfig()) -> None:
        super().__init__()
        self.config = config
        inputs = (CHANNELS + LOCATION) * COARSE**2
        self.body = EncoderDecoder(inputs, config.width)
        self.head = nn.Conv2d(config.width, (YAWS + 1) * config.channels, 1)
        self.log_scale = nn.Parameter(torch.tensor(INITIAL_SCALE).log())
        self.register_buffer("centres", location_channels(), persistent=False)

    def forward(self, drawings: Tensor) -> Spectra:
        """Embed (B, CHANNELS, CELLS, CELLS) drawings."""
        where = self.centres.expand(len(drawings), -1, -1, -1)
        fine = torch.cat([drawings, where], dim=1)
        out = self.head(self.body(F.pixel_unshuffle(fine, COARSE))).float()
        source, target = out.tensor_split((YAWS * self.config.channels,), dim=1)
        source = source.unflatten(1, (YAWS, -1))
        turned = torch.stack(
            [torch.rot90(source[:, yaw], yaw, (2, 3)) for yaw in range(YAWS)], dim=1
        )
        return Spectra(spectrum(turned), spectrum(target))

    def logits(self, source: Tensor, target: Tensor) -> Tensor:
        """(A, B, YAWS, SHIFTS, SHIFTS) of all pairs of A sources' and B targets' spectra; entry
        (k, i, j) is for a yaw of k quarter turns and a shift of -STEP_M (i, j), indices beyond
        half counting back from zero."""
        rows, columns = target.shape[-2:]
        back = source.conj().flatten(3).permute(3, 0, 1, 2).flatten(1, 2)
        met = back @ target.flatten(2).permute(2, 1, 0)
        met = met.reshape(rows, columns, len(source), YAWS, len(target)).permute(2, 4, 3, 0, 1)
        return torch.as_tensor(self.log_scale.exp() * torch.fft.irfft2(met, (SHIFTS, SHIFTS)))


def spectrum(planes: Tensor) -> Tensor:
    """`torch.fft.rfft2` of (..., GRID, GRID) padded to (SHIFTS, SHIFTS), with half of the work of
    its gradient."""
    found: Tensor = _Spectrum.apply(planes)  # type: ignore[no-untyped-call]
    return found


class _Spectrum(torch.autograd.Function):
    """The gradient of a real transform is real: a complex-to-real transform finds it, which counts
    every column but the first and the last twice."""

    @staticmethod
    def forward(ctx: Any, planes: Tensor) -> Tensor:
        return torch.as_tensor(torch.fft.rfft2(planes, (SHIFTS, SHIFTS)))

    @staticmethod
    def backward(ctx: Any, slope: Tensor) -> Tensor:
        share = torch.full(slope.shape[-1:], 0.5, device=slope.device)
        share[[0, -1]] = 1.0
        padded: Tensor = torch.fft.irfft2(slope * share, (SHIFTS, SHIFTS), norm="forward")
        return padded[..., :GRID, :GRID]


def shifts() -> Tensor:
    """(SHIFTS,) metres that the indices of a map stand for along each axis."""
    index = torch.arange(SHIFTS)
    return -STEP_M * torch.where(index < GRID, index, index - SHIFTS).float()
