"""The running program: a world of sim and render, and what shows it and takes the user's input.

In: a scene, and frames from a display. Out: pictures, recordings, statistics.
"""
