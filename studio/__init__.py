"""Procedural models of the shipped assets: meshes sampled with surfels, lit by ray casting, written as Gaussians.

In: nothing but code. Out: the .h5 files under assets/data (`python -m studio`).
Modules: shapes, textures and solids model; surface_sampling, baked_light and finish turn models into Gaussians.
"""
