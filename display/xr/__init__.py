"""The headset: an OpenXR session, hands, panel, comfort.

In: an OpenXR runtime. Out: frames for two eyes, hands and commands; haptics and layers back.
"""
