"""Density of a model: number of Gaussians, cage vertices, and rays of the baked light."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Detail:
    """Density that a model is asked for. The defaults are the model's own, as shipped.

    gaussians  factor on the model's own number of Gaussians
    vertices   wanted number of cage vertices; None: the model's own
    rays       factor on the model's own number of rays for each Gaussian
    """

    gaussians: float = 1.0
    vertices: int | None = None
    rays: float = 1.0

    def spacing(self, own: float) -> float:
        """Distance between Gaussians in a regular pattern [m], of a model whose own is `own`."""
        return own * self.gaussians**-0.5

    def cage_vertices(self, own: int) -> int:
        """Number of cage vertices to ask for, of a model whose own is `own`."""
        return own if self.vertices is None else self.vertices

    def ray_count(self, own: int) -> int:
        """Number of rays for each Gaussian, of a model whose own is `own`."""
        return max(8, round(own * self.rays))


SHIPPED = Detail()
ROUGH = Detail(gaussians=0.15, rays=0.2)  # to look at a model in the making
