"""Hands: grasp, throw, fingers, two-hand scaling.

In: hand poses of a frame. Out: springs and contacts on bodies, and the forces for haptics.
"""
