"""From solid Gaussians to a tetrahedral cage and the embedding.

In: Gaussians and a wished number of vertices.
Out: closed cages of positive volumes that hold them, and the host tets of each Gaussian's local tetrahedron.
"""
