"""What a user changes in a running world, and undo.

In: edit commands. Out: changed bodies, and snapshots to go back to.
"""
