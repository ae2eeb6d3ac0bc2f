"""Models of the attic: the room, and the boxes that are moved in it.

In: nothing but code. Out: assets, which `python -m studio` writes.
"""
