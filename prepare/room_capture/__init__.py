"""A captured room: what its cameras saw, its frame in metres, its background and its objects, as a ROOM/ folder.

In: a capture and the Gaussians that were trained from it.
Out: an environment, bodies with cages, and where they stood.
"""
