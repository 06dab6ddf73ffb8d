"""Colour and depth images on disk: headers read cheaply, pixels decoded when asked for.

A damaged PNG is recognised by its checksums before a decoder sees it, so nothing but our own
message reaches the user.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from fewview.errors import ScanError
from fewview.scans.files import read_bytes

Size = tuple[int, int]
"""Width and height in pixels."""

MAX_SIDE = 16384
MAX_PIXELS = 64_000_000
_HEAD_BYTES = 1 << 16
_TAIL_BYTES = 1 << 12
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}


class StoredImage(Protocol):
    """An image that is still encoded."""

    @property
    def label(self) -> str:
        """Names the image in messages."""

    def size(self) -> Size:
        """Width and height, after a cheap check of the image's type.

        Raises:
            ScanError: missing, empty, or of the wrong type.
        """

    def decode(self) -> NDArray[Any]:
        """The pixels: (H, W, 3) uint8 RGB for colour, (H, W) uint16 raw values for depth.

        Raises:
            ScanError: as `size`, or corrupt.
        """


@dataclass(frozen=True)
class ColourFile:
    """A colour image in a PNG or JPEG file."""

    path: Path

    @property
    def label(self) -> str:
        return str(self.path)

    def size(self) -> Size:
        return colour_size(_file_header(self.path), self.label)

    def decode(self) -> NDArray[np.uint8]:
        return decode_colour(read_bytes(self.path), self.label)


@dataclass(frozen=True)
class DepthFile:
    """A depth image in a 16-bit greyscale PNG file."""

    path: Path

    @property
    def label(self) -> str:
        return str(self.path)

    def size(self) -> Size:
        return depth_size(_file_header(self.path), self.label)

    def decode(self) -> NDArray[np.uint16]:
        return decode_depth(read_bytes(self.path), self.label)


@dataclass(frozen=True)
class ImageHeader:
    """What the first bytes of an image say."""

    kind: str
    width: int
    height: int
    channels: int
    bits: int


def parse_header(data: bytes, label: str) -> ImageHeader | None:
    """Read a PNG or JPEG header; None when ``data`` ends before it is complete.

    Raises:
        ScanError: no bytes at all, another kind of file, or an absurd size.
    """
    if not data:
        raise ScanError(f"{label} is empty (0 bytes): copy the file again or remove this scan")
    if data.startswith(_PNG_SIGNATURE):
        header = _png_header(data)
    elif data.startswith(_JPEG_START):
        header = _jpeg_header(data)
    else:
        raise ScanError(f"{label} is neither a PNG nor a JPEG image: export it as one of them")
    if header is not None:
        check_size(header.width, header.height, label)
    return header


def check_size(width: int, height: int, label: str) -> None:
    """Refuse images without pixels and images that no camera takes.

    Raises:
        ScanError: naming ``label``.
    """
    sides = 0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE
    if not sides or width * height > MAX_PIXELS:
        raise ScanError(f"{label} claims {width}x{height} pixels: the file is corrupt, replace it")


def colour_size(header: ImageHeader, label: str) -> Size:
    """The size of a colour image.

    Raises:
        ScanError: it has 16 bits a channel, like a depth image.
    """
    if header.bits > 8:
        raise ScanError(
            f"{label} has {header.bits} bits a channel; a colour image has 8 (is it the depth "
            "image?): export colour as 8-bit JPEG or PNG"
        )
    return header.width, header.height


def depth_size(header: ImageHeader, label: str) -> Size:
    """The size of a depth image.

    Raises:
        ScanError: it is not a 16-bit greyscale PNG.
    """
    if (header.kind, header.channels, header.bits) != ("PNG", 1, 16):
        raise ScanError(
            f"{label} is a {header.kind} with {header.channels} channel(s) of {header.bits} bits; "
            "a depth image must be a 16-bit greyscale PNG: export it as one"
        )
    return header.width, header.height


def decode_colour(data: bytes, label: str) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB, as stored: orientation tags are not applied.

    Raises:
        ScanError: corrupt or not a colour image.
    """
    colour_size(_complete_header(data, label), label)
    pixels = _decode(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, label)
    return np.ascontiguousarray(pixels[..., ::-1], dtype=np.uint8)


def decode_depth(data: bytes, label: str) -> NDArray[np.uint16]:
    """(H, W) uint16 raw values.

    Raises:
        ScanError: corrupt or not a depth image.
    """
    depth_size(_complete_header(data, label), label)
    return _decode(data, cv2.IMREAD_UNCHANGED, label).astype(np.uint16, copy=False)


def _decode(data: bytes, flags: int, label: str) -> NDArray[Any]:
    intact = (
        _png_is_intact(data) if data.startswith(_PNG_SIGNATURE) else b"\xff\xd9" in data[-4096:]
    )
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if intact else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise ScanError(f"{label} is corrupt: copy the file again or remove this scan")
    return np.asarray(pixels)


def _file_header(path: Path) -> ImageHeader:
    header = parse_header(read_bytes(path, _HEAD_BYTES), str(path))
    return header or _complete_header(read_bytes(path), str(path))


def _complete_header(data: bytes, label: str) -> ImageHeader:
    header = parse_header(data, label)
    if header is None:
        raise ScanError(f"{label} is corrupt: copy the file again or remove this scan")
    return header


def _png_header(data: bytes) -> ImageHeader | None:
    if len(data) < 33 or data[12:16] != b"IHDR":
        return None
    width, height, bits, colour_type = struct.unpack(">IIBB", data[16:26])
    return ImageHeader("PNG", width, height, _PNG_CHANNELS.get(colour_type, 0), bits)


def _jpeg_header(data: bytes) -> ImageHeader | None:
    """Walk the marker segments to the start-of-frame (ITU T.81, B.2.2)."""
    at = 2
    while at + 9 < len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            bits, height, width, channels = struct.unpack(">BHHB", data[at + 4 : at + 10])
            return ImageHeader("JPEG", width, height, channels, bits)
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


def _png_is_intact(data: bytes) -> bool:
    """Whether every chunk is complete, has the right checksum, and the last one is IEND."""
    at, view = len(_PNG_SIGNATURE), memoryview(data)
    while at + 12 <= len(data):
        length = int.from_bytes(view[at : at + 4], "big")
        end = at + 8 + length
        checksum = int.from_bytes(view[end : end + 4], "big")
        if end + 4 > len(data) or zlib.crc32(view[at + 4 : end]) != checksum:
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False
