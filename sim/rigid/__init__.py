"""Rigid bodies: pose and momentum, shapes, contact.

In: boxes, convex pieces, or cages. Out: poses, and the vertices that follow them.
"""
