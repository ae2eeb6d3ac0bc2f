"""The ways to put Gaussians in order, front to back, and which one a moving head gets.

z       by camera z, once for all pixels: as they were trained, and as other renderers do it
radial  by the distance from the eye, once: a head that turns changes no place
pixel   in each pixel by the distance along its ray (render/resort.py): also where Gaussians cross
"""

SORTS = ("z", "radial", "pixel")
MOVING_SORT = "radial"  # of the headset and the window. No Gaussian pops when the head turns, at the cost of z; pixel
# takes off most of the remaining error for two to three times the time of a picture (tests/bench/NOTES.md).
