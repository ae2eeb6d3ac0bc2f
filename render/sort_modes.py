"""The ways to put Gaussians in order, front to back, and which one a moving head gets.

z       by camera z, once for all pixels: as they were trained, and as other renderers do it
radial  by the distance from the eye, once: a head that turns changes no place
pixel   in each pixel by the distance along its ray (render/per_pixel_sort.py): right also where Gaussians cross
"""

SORTS = ("z", "radial", "pixel")
MOVING_SORT = "radial"  # of the window and the headset: the least change in a turn, for the time of z; pixel, the
# least popping and error, takes three times as long on a CPU and 1.8 times on a GPU (bench/NOTES.md)
