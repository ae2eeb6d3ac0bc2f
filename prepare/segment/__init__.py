"""Objects in captures and splats: marks of the user, masks of photographs, the objects' Gaussians."""
