"""The Rerun viewer that is installed beside the package: open a recording, or watch a run."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

from fewview.errors import FewviewError

HOST = "127.0.0.1"
PORT = 9876
START_S = 20.0
SETTLE_S = 0.5


def view(path: Path) -> None:
    """Show a recording and return when the viewer is closed.

    Raises:
        FewviewError: the file is missing, or there is no viewer or no display.
    """
    if not path.is_file():
        raise FewviewError(f"{path}: no such recording; `fewview reconstruct` writes one")
    command = [_executable(), "--bind", HOST, "--new", str(path)]
    code = subprocess.run(command, check=False).returncode
    if code != 0:
        raise FewviewError(f"{path}: the Rerun viewer stopped with exit code {code}")


def start() -> str:
    """Start a viewer that outlives this process, or find the one that runs already.

    Returns:
        The address that a recording can be streamed to; only this machine can reach it.

    Raises:
        FewviewError: there is no viewer or no display, or it does not start.
    """
    if not _listening():
        command = [_executable(), "--bind", HOST, "--port", str(PORT), "--expect-data-soon"]
        process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        _await(process)
    return f"rerun+http://{HOST}:{PORT}/proxy"


def _await(process: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + START_S
    while not _listening() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    # The viewer listens before it opens its window, and stops when it cannot.
    time.sleep(SETTLE_S)
    if process.poll() is not None or not _listening():
        raise FewviewError("the Rerun viewer does not start; run without --view")


def _listening() -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, PORT)) == 0


def _executable() -> str:
    folders = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    found = shutil.which("rerun", path=folders)
    if found is None:
        raise FewviewError("the Rerun viewer is not installed; run `pip install rerun-sdk`")
    if not _display():
        raise FewviewError(
            "the Rerun viewer needs a display; copy the .rrd file to a desktop and open it there"
        )
    return found


def _display() -> bool:
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
