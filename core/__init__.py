"""Types and functions shared by all packages: rotations, cameras, materials, tet meshes, distance grids, device fields.

In: nothing of this program. Out: small modules that every other package may import.
"""
