"""Other programs on the same work, side by side.

In: a peer that is installed beside this program. Out: rows of both.
"""
