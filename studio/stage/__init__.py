"""The stage: a small theatre with boards, red curtains, a painted backdrop and spotlights, and the hall before it.

In: nothing but code. Out: the asset `stage`.
"""
