"""Session recordings: the user's input, kept and played again exactly.

In: frames. Out: an HDF5 file, and frames again.
"""
