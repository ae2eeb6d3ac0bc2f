"""Static scenes: what is solid, where tables are, where to stand.

In: Gaussians of a room or garden. Out: distance grids, planes and places to play.
"""
