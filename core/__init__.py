"""What all packages speak: errors, rotations, cameras, materials, tet meshes, distance grids, harmonics, device fields.

In: nothing of ours. Out: small types and functions that every other package may import.
"""
