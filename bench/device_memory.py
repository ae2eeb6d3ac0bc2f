"""Memory that is taken on the GPU, as its driver counts it: the same for Taichi and for other frameworks."""

from __future__ import annotations

import ctypes
from ctypes.util import find_library


class _Memory(ctypes.Structure):
    _fields_ = (("total", ctypes.c_ulonglong), ("free", ctypes.c_ulonglong), ("used", ctypes.c_ulonglong))


def device_memory() -> float | None:
    """Memory in use on the first GPU by all processes [MiB], or None without NVIDIA's management library."""
    try:
        nvml = ctypes.CDLL(find_library("nvidia-ml") or "libnvidia-ml.so.1")
    except OSError:
        return None
    device, memory = ctypes.c_void_p(), _Memory()
    if nvml.nvmlInit_v2() or nvml.nvmlDeviceGetHandleByIndex_v2(0, ctypes.byref(device)):
        return None
    failed = nvml.nvmlDeviceGetMemoryInfo(device, ctypes.byref(memory))
    return None if failed else memory.used / 2**20
