"""Measurements of the program: physics against theory, speed, quality.

In: sizes and a device. Out: tables and JSON rows.
"""
