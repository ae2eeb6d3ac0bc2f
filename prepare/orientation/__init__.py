"""Orientation of captures: the up axis, the size, and the front.

From the cameras of a capture where there are some, and pictures of the possible answers where there are none.
"""
