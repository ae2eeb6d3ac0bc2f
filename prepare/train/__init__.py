"""Training: photographs with poses to Gaussians.

In: a capture (photographs and their cameras). Out: Gaussians, and their quality on held-out photographs.
"""
