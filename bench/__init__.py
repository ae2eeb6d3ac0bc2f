"""What the program measures of itself: physics against theory, speed, quality.

In: sizes and a device. Out: tables and JSON rows.
"""
