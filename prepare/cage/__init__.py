"""From solid Gaussians to a tetrahedral cage and the embedding.

In: Gaussians and a wished number of vertices. Out: a closed cage of positive volumes that holds them.
"""
