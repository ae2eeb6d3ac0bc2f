"""The dining room of the ring toss and the bottle that stands in it.

In: shapes, textures and light of studio. Out: the Gaussians and signed distances of the assets `dining_room` and
`bottle`. Each module holds the measures of what it models, in metres: +y up, floor at y = 0, the player on the +z side.
"""
