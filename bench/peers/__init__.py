"""Comparisons with other programs on the same task.

In: a program installed beside this one. Out: rows of both.
"""
