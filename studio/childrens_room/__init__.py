"""The children's room: a shell with painted hills, a bed, a shelf, a play tent, and what children leave about.

In: nothing but code. Out: the asset `childrens_room`.
"""
