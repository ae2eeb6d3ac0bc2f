"""The desktop window: OpenGL, mouse and keys, the panel.

In: events by name. Out: frames with cameras, a mouse hand and commands; the picture on the screen.
"""
