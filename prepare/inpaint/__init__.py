"""Inpainting: fills what an object hid where no camera saw it."""
