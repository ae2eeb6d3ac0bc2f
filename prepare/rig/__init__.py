"""Animated bodies: a rig's motion on a person's splat, or a skinned mesh with its own.

In: a prepared body or a .glb, and a skeleton with a motion.
Out: an asset with an animation.
"""
