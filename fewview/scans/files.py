"""Reading bytes, text and numbers from files that may be missing, huge or broken."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from fewview.errors import ScanError
from fewview.types import Array

MAX_BYTES = 256 << 20
"""No single image or text file of a scan is larger; longer ones are refused unread."""


def read_bytes(path: Path, limit: int | None = None) -> bytes:
    """The file's content, or its first ``limit`` bytes.

    Raises:
        ScanError: the file cannot be read, or is larger than `MAX_BYTES` and no limit is given.
    """
    try:
        if limit is None and path.stat().st_size > MAX_BYTES:
            raise ScanError(f"{path} is larger than {MAX_BYTES >> 20} MB: not a file of one scan")
        with path.open("rb") as stream:
            return stream.read(limit if limit is not None else MAX_BYTES)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ScanError(f"{path} cannot be read ({reason}): copy the file again") from error


def read_text(path: Path) -> str:
    """The file as UTF-8 text.

    Raises:
        ScanError: unreadable or not text.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScanError(f"{path} is not a text file: write it again as plain numbers") from error


def numbers(text: str, label: str) -> Array:
    """All whitespace- or comma-separated numbers of ``text``; NaN and inf pass.

    Raises:
        ScanError: a word is not a number; ``label`` names the file.
    """
    words = text.replace(",", " ").split()
    try:
        return np.array([float(word) for word in words])
    except ValueError as error:
        raise ScanError(f"{label} holds something that is not a number ({error})") from error


def table(path: Path) -> list[list[str]]:
    """The words of each line that is neither empty nor a ``#`` comment."""
    lines = (line.split() for line in read_text(path).splitlines())
    return [words for words in lines if words and not words[0].startswith("#")]


def natural_order(name: str) -> tuple[list[str | int], str]:
    """A sort key that puts ``frame-9`` before ``frame-10``."""
    parts = re.split(r"([0-9]+)", name)
    return [int(part) if i % 2 else part for i, part in enumerate(parts)], name
