"""The demos: one file each, data and a small game; no Taichi, no files.

In: asset names. Out: a `Scene` from `build`, found by `scenes.registry`.
"""
