"""Sound of impacts: found in the motion of bodies, synthesised from their size and material, mixed and played."""
