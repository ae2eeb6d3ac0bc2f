"""The garden: a lawn among hedges, an apple tree, flower beds, a fence and a bench, under a summer sky.

In: nothing but code. Out: the asset `garden`.
"""
