"""Objects in captures and splats: the user's marks, masks of photographs, and the objects' Gaussians."""
