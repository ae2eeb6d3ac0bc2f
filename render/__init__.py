"""Gaussians to pixels: projection, sort, tiles, blending, shadow map.

In: device fields of Gaussians and cameras. Out: one ndarray that holds the picture.
"""
