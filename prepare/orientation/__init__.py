"""Orientation of captures: up axis, scale and front.

From the cameras of a capture where there are some; else pictures of the alternatives for the user.
"""
