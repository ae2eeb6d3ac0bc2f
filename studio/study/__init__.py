"""Models of the study: the room, and what is played with on its table.

In: nothing but code. Out: assets, which `python -m studio` writes.
"""
