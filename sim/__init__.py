"""The physics on the device: solver, bodies, embedding.

In: bodies, static shapes, hands. Out: fields of positions that the embedding carries Gaussians with, and readbacks.
"""
