"""Elasticity of tetrahedral bodies: the energy, and the XPBD and VBD substeps that minimise it.

In: the state of a substep. Out: increments of its vertices, and a substep that suits the stiffness.
"""
