"""Fitting: the material of a real thing, from how it moved.

In: a prepared body, and tracks of points on it.
Out: Young's modulus, damping, friction and yield strain with their intervals, and a report.
"""
