"""The dining room of the ring toss.

In: shapes, textures and light of studio. Out: the Gaussians and solids of the room.
"""
