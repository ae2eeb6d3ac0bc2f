"""Contact of bodies with static shapes, one another, themselves and hands.

In: surface samples and shapes. Out: corrections of the increments of vertices and rigid bodies, and forces.
"""
