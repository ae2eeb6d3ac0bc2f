"""A captured room: its frame in metres, its background and its objects, written to a ROOM/ folder.

In: a capture and the Gaussians that were trained on it.
Out: an environment, and bodies with cages in their captured places.
"""
