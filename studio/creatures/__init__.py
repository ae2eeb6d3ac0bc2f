"""Models of animals and plush toys: smooth unions of simple solids, covered with skin and hair.

In: nothing but code. Out: assets with a cage, which `python -m studio` writes.
`implicit` and `creature` describe a shape, `coat` and `sky_light` turn it into Gaussians; a file for each animal, three
for the toys.
"""
