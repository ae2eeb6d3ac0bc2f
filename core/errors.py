"""The error that a user's input can cause."""


class BadInput(Exception):
    """Input that cannot be used. Its message is one line that names the object and the defect.

    `vrgs.py` prints it without a traceback and exits with status 2.
    """
