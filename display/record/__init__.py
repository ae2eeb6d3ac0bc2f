"""Session recordings: the user's input, stored and replayed exactly.

In: frames. Out: an HDF5 file, and frames again.
"""
