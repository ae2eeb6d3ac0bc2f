"""Displays without a screen: pictures, films, strips.

In: a world and a number of frames. Out: PNG and MP4 files, written whole or not at all.
"""
