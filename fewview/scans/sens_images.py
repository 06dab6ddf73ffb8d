"""Images inside a ScanNet ``.sens`` file: read by offset, depth inflated to its exact size."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from fewview.errors import ScanError
from fewview.scans import images
from fewview.scans.images import Size


@dataclass(frozen=True)
class Piece:
    """An encoded image inside the file."""

    path: Path
    label: str
    offset: int
    length: int
    image_size: Size

    def size(self) -> Size:
        """Width and height that the file's header gives."""
        return self.image_size

    def content(self) -> bytes:
        """The encoded bytes.

        Raises:
            ScanError: the file became unreadable or shorter.
        """
        with opened(self.path) as stream:
            stream.seek(self.offset)
            return exactly(stream, self.length, self.path)


@dataclass(frozen=True)
class SensColour(Piece):
    """A JPEG or PNG colour image."""

    def decode(self) -> NDArray[np.uint8]:
        """(H, W, 3) RGB.

        Raises:
            ScanError: corrupt.
        """
        return images.decode_colour(self.content(), self.label)


@dataclass(frozen=True)
class SensDepth(Piece):
    """A depth image, raw or deflated 16-bit values."""

    deflated: bool

    def decode(self) -> NDArray[np.uint16]:
        """(H, W) raw values.

        Raises:
            ScanError: corrupt, or not of the size that the header gives.
        """
        width, height = self.image_size
        data, expected = self.content(), 2 * width * height
        if self.deflated:
            data = self._inflated(data, expected + 1)
        if len(data) != expected:
            raise ScanError(
                f"{self.label} does not hold {width}x{height} values: the file is corrupt, "
                "download it again"
            )
        return np.frombuffer(data, dtype="<u2").reshape(height, width).astype(np.uint16)

    def _inflated(self, data: bytes, limit: int) -> bytes:
        try:
            return zlib.decompressobj().decompress(data, limit)
        except zlib.error as error:
            raise ScanError(
                f"{self.label} is corrupt ({error}): download the file again"
            ) from error


def opened(path: Path) -> IO[bytes]:
    """The file, open for reading.

    Raises:
        ScanError: it cannot be opened.
    """
    try:
        return path.open("rb")
    except OSError as error:
        raise ScanError(f"{path} cannot be read ({error.strerror}): check the path") from error


def exactly(stream: IO[bytes], length: int, path: Path) -> bytes:
    """The next ``length`` bytes.

    Raises:
        ScanError: there are fewer, or reading fails.
    """
    try:
        data = stream.read(length)
    except OSError as error:
        raise ScanError(f"{path} cannot be read ({error.strerror}): copy it again") from error
    if len(data) != length:
        raise ScanError(corrupt(path, "it ends too early"))
    return data


def corrupt(path: Path, what: str) -> str:
    """The message for a file that contradicts itself."""
    return f"{path} is corrupt ({what}): download it again"
