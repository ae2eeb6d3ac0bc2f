"""The picture from CUDA to OpenGL without a way through the host: CUDA's driver API, chapter "OpenGL Interoperability".

The driver's own library is called, which is there wherever Taichi runs on CUDA. OpenGL must run on the same GPU as it.
"""

from __future__ import annotations

import ctypes
import sys

TEXTURE_2D = 0x0DE1  # OpenGL's name of the kind of texture
WRITE_DISCARD = 0x02  # CU_GRAPHICS_REGISTER_FLAGS_WRITE_DISCARD
DEVICE, ARRAY = 2, 3  # CUmemorytype
BYTES = 4  # of a pixel


class NoInterop(Exception):
    """This picture cannot go to OpenGL on the device; the message says why."""


class Copy2D(ctypes.Structure):
    """CUDA_MEMCPY2D_v2: what `cuMemcpy2DAsync_v2` copies from where to where."""

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
        self._cuda = driver()
        self._context()
        self._resource = ctypes.c_void_p()
        self._call("cuGraphicsGLRegisterImage", ctypes.byref(self._resource), texture.glo, TEXTURE_2D, WRITE_DISCARD)

    def _context(self) -> None:
        """Taichi's context, the device's primary one, must be this thread's."""
        current = ctypes.c_void_p()
        self._call("cuCtxGetCurrent", ctypes.byref(current))
        if not current:
            device, primary = ctypes.c_int(), ctypes.c_void_p()
            self._call("cuDeviceGet", ctypes.byref(device), 0)
            self._call("cuDevicePrimaryCtxRetain", ctypes.byref(primary), device)
            self._call("cuCtxSetCurrent", primary)

    def _call(self, name: str, *arguments) -> None:
        status = getattr(self._cuda, name)(*arguments)
        if status != 0:
            raise NoInterop(f"{name} says {status}")

    def write(self, address: int) -> None:
        """Take over the pixels at an address of the device, row after row, when what draws them is done."""
        width, height = self.texture.size
        array = ctypes.c_void_p()
        self._call("cuGraphicsMapResources", 1, ctypes.byref(self._resource), None)
        try:
            self._call("cuGraphicsSubResourceGetMappedArray", ctypes.byref(array), self._resource, 0, 0)
            copy = Copy2D(
                srcMemoryType=DEVICE,
                srcDevice=address,
                srcPitch=width * BYTES,
                dstMemoryType=ARRAY,
                dstArray=array,
                WidthInBytes=width * BYTES,
                Height=height,
            )
            self._call("cuMemcpy2DAsync_v2", ctypes.byref(copy), None)
        finally:
            self._call("cuGraphicsUnmapResources", 1, ctypes.byref(self._resource), None)

    def close(self) -> None:
        """Let the texture go, before OpenGL does. Further calls do nothing."""
        if self._resource:
            self._cuda.cuGraphicsUnregisterResource(self._resource)
            self._resource = ctypes.c_void_p()


def driver():
    """CUDA's driver. Raises NoInterop."""
    try:
        cuda = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError as e:
        raise NoInterop("there is no CUDA driver") from e
    pointer, handle, number = ctypes.c_void_p, ctypes.POINTER(ctypes.c_void_p), ctypes.c_uint
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
        getattr(cuda, name).argtypes = kinds
    return cuda
