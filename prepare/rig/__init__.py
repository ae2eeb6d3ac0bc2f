"""Bodies that move by themselves: a rig on a person's splat, or a skinned mesh.

In: a prepared body or a .glb, and a skeleton with a motion. Out: an asset with an animation.
"""
