"""Inpainting: what an object hid is made up where no camera saw it."""
