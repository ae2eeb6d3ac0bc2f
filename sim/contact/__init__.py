"""Contact of bodies with static shapes, one another, themselves and hands: broad phase, narrow phases, constraints, response.

In: surface samples and shapes. Out: corrections of the increments of vertices and rigid bodies, and forces.
"""
