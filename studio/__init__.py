"""Models the assets that we ship, from code.

In: nothing but code. Out: the .h5 files under assets/data.
"""
