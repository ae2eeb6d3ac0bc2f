"""From splats to assets that can be played with: pipeline, checkpoints, report.

In: Gaussians of a capture, or a .glb mesh.
Out: an asset with cage, embedding and distance grid (or a static environment), and a report.
"""
