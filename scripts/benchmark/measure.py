"""Run a command and measure what it and all its children took."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

POLL_S = 0.3


@dataclass(frozen=True)
class Measured:
    """What a finished command took.

    Attributes:
        code: its exit code.
        wall_s: wall-clock seconds from start to end, imports included.
        cpu_s: user and system seconds of the process and its children.
        peak_mb: largest sum of proportional set sizes of the process tree, sampled.
        errors: the last lines it wrote to stderr.
    """

    code: int
    wall_s: float
    cpu_s: float
    peak_mb: float
    errors: str


def measure(command: Sequence[str | Path], env: Mapping[str, str], cwd: Path) -> Measured:
    """Run ``command`` with ``env`` added to the environment; stdout is discarded."""
    with tempfile.TemporaryFile("w+") as errors:
        start, peak = time.perf_counter(), 0.0
        process = subprocess.Popen(
            [str(part) for part in command],
            cwd=cwd,
            env={**os.environ, **env},
            stdout=subprocess.DEVNULL,
            stderr=errors,
        )
        while (ended := os.wait4(process.pid, os.WNOHANG))[0] == 0:
            peak = max(peak, _tree_mb(process.pid))
            time.sleep(POLL_S)
        wall_s = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(ended[1])
        usage = ended[2]
        errors.seek(0)
        tail = "".join(errors.readlines()[-20:])
    cpu_s = usage.ru_utime + usage.ru_stime
    return Measured(process.returncode, wall_s, cpu_s, max(peak, usage.ru_maxrss / 1024), tail)


def _tree_mb(pid: int) -> float:
    total = 0
    try:
        parent = psutil.Process(pid)
        for member in (parent, *parent.children(recursive=True)):
            total += member.memory_full_info().pss
    except (psutil.NoSuchProcess, psutil.AccessDenied):
        pass
    return total / 2**20
