"""One module for each file format of splats and skinned meshes.

In: bytes from untrusted sources. Out: checked Gaussians (or rigs and meshes), and files of some formats.
"""
