"""A world as displays see it, without bodies, light and game unless given."""

from display.protocol import WorldView


class FakeView(WorldView):
    """`FakeView(paused=True, bodies=lambda: [...])`."""

    def __init__(self, **attributes):
        self.__dict__.update(attributes)
