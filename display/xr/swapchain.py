"""Textures that the runtime owns and we draw into."""

from __future__ import annotations

SRGB8_ALPHA8, RGBA8 = 0x8C43, 0x8058  # OpenGL's names of formats, best first


def swapchain(xr, session, size: tuple[int, int], kind: int, *, depth: bool = False):
    """A swapchain of plain textures of `size` (width, height) [px] in OpenGL's format `kind`, of colour or of depth."""
    flags = xr.SwapchainUsageFlags
    attached = flags.DEPTH_STENCIL_ATTACHMENT_BIT if depth else flags.COLOR_ATTACHMENT_BIT
    how = xr.SwapchainCreateInfo(
        usage_flags=attached | flags.SAMPLED_BIT,
        format=kind,
        sample_count=1,
        width=size[0],
        height=size[1],
        face_count=1,
        array_size=1,
        mip_count=1,
    )
    return xr.create_swapchain(session, how)


def format_of(xr, session, wanted: tuple[int, ...]) -> int | None:
    """The first of the `wanted` formats that the runtime has."""
    there = list(xr.enumerate_swapchain_formats(session))
    return next((f for f in wanted if f in there), None)
