"""Gaussians to pixels: projection, sort, tiles, blending, shadow map.

In: device fields of Gaussians and cameras. Out: one ndarray that holds the picture.
Orders of blending, front to back (SORTS):

z       by camera z, once for all pixels: as Gaussians are trained, and as other renderers do it
radial  by the distance from the eye, once: a turn of the head changes nothing
pixel   in each pixel by the distance along its ray (render/per_pixel_sort.py): correct where Gaussians cross as well
"""

from assets.gaussians import SORTS as SORTS

MOVING_SORT = "radial"  # of the window and the headset: the least change in a turn, for the time of z; pixel, with the
# least popping and error, takes three times as long on a CPU and 1.8 times on a GPU (bench/NOTES.md)
