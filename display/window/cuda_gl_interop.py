"""Copies the picture from CUDA to OpenGL on the device (CUDA driver API, chapter "OpenGL Interoperability").

The driver's own library is called, which is there wherever Taichi runs on CUDA. OpenGL must run on the same GPU.
"""

from __future__ import annotations

import ctypes
import sys

TEXTURE_2D = 0x0DE1  # OpenGL's enum
WRITE_DISCARD = 0x02  # CU_GRAPHICS_REGISTER_FLAGS_WRITE_DISCARD
DEVICE, ARRAY = 2, 3  # CUmemorytype
BYTES_PER_PIXEL = 4


class NoInterop(Exception):
    """This picture cannot go to OpenGL on the device; the message says why."""


class Copy2D(ctypes.Structure):
    """CUDA_MEMCPY2D_v2: source, destination and extent of `cuMemcpy2DAsync_v2`."""

    _fields_ = [
        (side + name, kind)
        for side in ("src", "dst")
        for name, kind in (
            ("XInBytes", ctypes.c_size_t),
            ("Y", ctypes.c_size_t),
            ("MemoryType", ctypes.c_int),
            ("Host", ctypes.c_void_p),
            ("Device", ctypes.c_uint64),
            ("Array", ctypes.c_void_p),
            ("Pitch", ctypes.c_size_t),
        )
    ] + [("WidthInBytes", ctypes.c_size_t), ("Height", ctypes.c_size_t)]


class CudaTexture:
    """An OpenGL texture (moderngl, RGBA of 8 bits a channel) that CUDA can write. Raises NoInterop."""

    def __init__(self, texture):
        self.texture = texture
        self._functions = driver_functions()
        self._make_current()
        self._resource = ctypes.c_void_p()
        self._call("cuGraphicsGLRegisterImage", ctypes.byref(self._resource), texture.glo, TEXTURE_2D, WRITE_DISCARD)

    def _make_current(self) -> None:
        """Make Taichi's context, the device's primary one, this thread's."""
        current = ctypes.c_void_p()
        self._call("cuCtxGetCurrent", ctypes.byref(current))
        if not current:
            device, primary = ctypes.c_int(), ctypes.c_void_p()
            self._call("cuDeviceGet", ctypes.byref(device), 0)
            self._call("cuDevicePrimaryCtxRetain", ctypes.byref(primary), device)
            self._call("cuCtxSetCurrent", primary)

    def _call(self, name: str, *arguments) -> None:
        status = self._functions[name](*arguments)
        if status != 0:
            raise NoInterop(f"{name} returns {status}")

    def write(self, address: int) -> None:
        """Copy the pixels at an address of the device, row after row, once the kernels that draw them are done."""
        width, height = self.texture.size
        array = ctypes.c_void_p()
        self._call("cuGraphicsMapResources", 1, ctypes.byref(self._resource), None)
        try:
            self._call("cuGraphicsSubResourceGetMappedArray", ctypes.byref(array), self._resource, 0, 0)
            copy = Copy2D(
                srcMemoryType=DEVICE,
                srcDevice=address,
                srcPitch=width * BYTES_PER_PIXEL,
                dstMemoryType=ARRAY,
                dstArray=array,
                WidthInBytes=width * BYTES_PER_PIXEL,
                Height=height,
            )
            self._call("cuMemcpy2DAsync_v2", ctypes.byref(copy), None)
        finally:
            self._call("cuGraphicsUnmapResources", 1, ctypes.byref(self._resource), None)

    def close(self) -> None:
        """Unregister the texture, before OpenGL deletes it. Further calls do nothing."""
        if self._resource:
            self._functions["cuGraphicsUnregisterResource"](self._resource)
            self._resource = ctypes.c_void_p()


def driver_functions() -> dict:
    """Functions of CUDA's driver by name. Raises NoInterop."""
    try:
        cuda = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError as e:
        raise NoInterop("there is no CUDA driver") from e
    pointer, handle, number = ctypes.c_void_p, ctypes.POINTER(ctypes.c_void_p), ctypes.c_uint
    functions = {}
    for name, kinds in {
        "cuCtxGetCurrent": (handle,),
        "cuDeviceGet": (ctypes.POINTER(ctypes.c_int), ctypes.c_int),
        "cuDevicePrimaryCtxRetain": (handle, ctypes.c_int),
        "cuCtxSetCurrent": (pointer,),
        "cuGraphicsGLRegisterImage": (handle, number, number, number),
        "cuGraphicsMapResources": (number, handle, pointer),
        "cuGraphicsUnmapResources": (number, handle, pointer),
        "cuGraphicsSubResourceGetMappedArray": (handle, pointer, number, number),
        "cuMemcpy2DAsync_v2": (ctypes.POINTER(Copy2D), pointer),
        "cuGraphicsUnregisterResource": (pointer,),
    }.items():
        functions[name] = cuda[name]
        functions[name].argtypes = kinds
    return functions
