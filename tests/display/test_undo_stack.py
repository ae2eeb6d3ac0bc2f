"""Taking back and doing again, without a world."""

from display.edit.editor import Step, UndoStack


class Counter:
    """A number that actions change, and its history."""

    def __init__(self, **limits):
        self.value, self.history = 0, UndoStack(**limits)

    def now(self, step: Step) -> Step:
        return Step(step.action, self.value, {id(self.value): 10})

    def act(self, value: int) -> None:
        self.history.add(self.now(Step("set", None)))
        self.value = value

    def back(self) -> bool:
        return self._go(self.history.back(self.now))

    def forth(self) -> bool:
        return self._go(self.history.forth(self.now))

    def _go(self, step: Step | None) -> bool:
        if step is not None:
            self.value = step.state
        return step is not None


def test_back_and_forth_walk_along_the_same_states():
    c = Counter()
    for value in (3, 1, 4):
        c.act(value)
    seen = [c.value]
    while c.back():
        seen.append(c.value)
    assert seen == [4, 1, 3, 0]
    again = [c.value]
    while c.forth():
        again.append(c.value)
    assert again == seen[::-1]
    assert not c.forth()


def test_a_new_action_ends_what_could_be_done_again():
    c = Counter()
    c.act(1)
    c.act(2)
    assert c.back() and c.value == 1
    c.act(7)
    assert not c.forth() and c.value == 7
    assert c.back() and c.value == 1 and c.back() and c.value == 0 and not c.back()


def test_the_oldest_steps_are_forgotten():
    c = Counter(steps=5)
    for value in range(1, 21):
        c.act(value)
    count = 0
    while c.back():
        count += 1
    assert count == 5 and c.value == 15


def test_so_are_those_that_take_too_much_but_what_is_shared_counts_once():
    history, shared = UndoStack(steps=100, size=1000), object()
    for _ in range(20):
        own = object()
        history.add(Step("move", own, {id(own): 100, id(shared): 300}))
        assert history.bytes <= 1000
    assert len(history.done) == 7
    huge = object()
    history.add(Step("move", huge, {id(huge): 5000}))
    assert history.done == [] and history.bytes == 0
