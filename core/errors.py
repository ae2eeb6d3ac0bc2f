"""The error that a user's input can cause."""


class BadInput(Exception):
    """Input that cannot be used. Its message is one line that names the object and the defect.

    `vrgs.py` prints it without a traceback and exits with status 2.
    """


class Cancelled(Exception):
    """Raised where the user gives up what is being loaded; `quits` if the program with it."""

    def __init__(self, *, quits: bool):
        super().__init__("cancelled")
        self.quits = quits
