"""One module for each splat file format.

In: bytes that may come from anywhere. Out: checked Gaussians, and the way back where the format is written.
"""
