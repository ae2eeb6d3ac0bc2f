"""Files that the user keeps of a play: pictures, films, states, exported splats and cages, cameras.

In: commands and the world after a frame. Out: files, and a notice of where they are.
"""
