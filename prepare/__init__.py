"""From splats to what can be played: pipeline and report.

In: Gaussians of a capture. Out: an asset with cage, embedding, distance grid, and a report.
"""
