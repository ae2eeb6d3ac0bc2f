"""The panel over the picture (ImGui): a section a file, listed in panel.py.

In: the world's view. Out: the user's commands, and a choice of resolution.
"""
