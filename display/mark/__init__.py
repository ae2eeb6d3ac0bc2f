"""Marking objects by strokes and boxes on pictures, in a window."""
