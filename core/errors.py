"""The error that a user's input can cause."""

SHOWN_MAX = 1000  # [characters] of a message: what a file says may have millions


class BadInput(Exception):
    """Input that cannot be used. Its message is one line that names the object and the defect.

    `vrgs.py` prints it without a traceback and exits with status 2. What a file says may be part of it: line breaks and
    all else that cannot be printed are escaped, and the middle of a long message is left out.
    """

    def __init__(self, message: object = ""):
        text = str(message)
        text = text if len(text) <= SHOWN_MAX else f"{text[: SHOWN_MAX // 2]} ... {text[-SHOWN_MAX // 2 :]}"
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in text))


class Cancelled(Exception):
    """Raised where the user gives up what is being loaded; `quits` if the program with it."""

    def __init__(self, *, quits: bool):
        super().__init__("cancelled")
        self.quits = quits
