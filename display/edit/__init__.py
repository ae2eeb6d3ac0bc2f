"""Edits of a running world, and undo.

In: edit commands. Out: changed bodies, and snapshots to return to.
"""
