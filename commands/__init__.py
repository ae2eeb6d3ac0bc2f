"""The command line: one module for each command.

In: parsed arguments. Out: an exit status.
"""
