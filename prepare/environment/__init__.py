"""Static environments (a room, a garden): solid space, support planes, and where to stand.

In: Gaussians of a capture.
Out: distance grids, support planes, a drop point and the user's eye.
"""
