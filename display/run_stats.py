"""Statistics of a run, as `--stats` writes them."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, read_json
from core.errors import BadInput

ROWS_MAX = 16 << 20  # [bytes] of rows


def run_stats(world, frames: int) -> dict:
    """Statistics of a run of `frames` frames: the world's own, its timings and the process's memory."""
    timings = world.timings
    light = {} if timings.to_light is None else {"motion_to_photon_ms": 1e3 * timings.to_light}
    return {
        "frames": frames,
        "fps": timings.fps,
        "stages": timings.as_dict(),
        **world.stats(),
        "missed_frames": timings.missed,
        "worst_frame_ms": 1e3 * timings.worst,
        "dropped_seconds": timings.dropped,
        **light,
        "peak_memory_mb": peak_memory_mb(),
    }


def write_stats(path: str | Path, stats: dict) -> None:
    """Write JSON, whole or not at all; NaN becomes null. Raises BadInput."""
    with atomic_write(path) as beside:
        beside.write_text(json.dumps(plain(stats), indent=2) + "\n", encoding="utf-8")


def read_rows(path: Path, subject: str, valid: Callable[[dict], bool]) -> list[dict]:
    """Rows of `bench SUBJECT` that `write_stats` wrote, each of which is `valid`. Raises BadInput."""
    rows = read_json(path, ROWS_MAX)
    known = isinstance(rows, list) and rows and all(isinstance(r, dict) and r.get("bench") == subject for r in rows)
    if not known or not all(map(valid, rows)):
        raise BadInput(f"{path}: holds no rows of bench {subject}")
    return rows


def plain(value):
    """The value in types that strict JSON has: NumPy scalars become Python's, NaN and infinity null."""
    if isinstance(value, dict):
        return {str(key): plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far [MB = 1e6 bytes]."""
    if sys.platform == "win32":
        return _peak_memory_windows() / 1e6
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6  # bytes on macOS, KiB elsewhere


def _peak_memory_windows() -> int:
    """PeakWorkingSetSize [bytes] of GetProcessMemoryInfo (psapi): Windows has no getrusage."""
    import ctypes
    from ctypes import wintypes

    sizes = "PeakWorkingSetSize WorkingSetSize QuotaPeakPagedPoolUsage QuotaPagedPoolUsage"
    sizes += " QuotaPeakNonPagedPoolUsage QuotaNonPagedPoolUsage PagefileUsage PeakPagefileUsage"

    class Counters(ctypes.Structure):
        """PROCESS_MEMORY_COUNTERS."""

        _fields_ = [("cb", wintypes.DWORD), ("PageFaultCount", wintypes.DWORD)] + [
            (name, ctypes.c_size_t) for name in sizes.split()
        ]

    counters = Counters(cb=ctypes.sizeof(Counters))
    process = ctypes.windll.kernel32.GetCurrentProcess
    process.restype = wintypes.HANDLE
    read = ctypes.windll.psapi.GetProcessMemoryInfo
    read.argtypes = [wintypes.HANDLE, ctypes.POINTER(Counters), wintypes.DWORD]
    if not read(process(), ctypes.byref(counters), counters.cb):
        raise ctypes.WinError()
    return counters.PeakWorkingSetSize
