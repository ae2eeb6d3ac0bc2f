"""Training: photographs with poses to Gaussians.

In: a capture, images and their cameras. Out: Gaussians, and a report of how well unseen images are met.
"""
