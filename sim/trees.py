"""All device memory of an object and of what it is made of."""

from taichi._snode.snode_tree import SNodeTree


def trees_of(thing) -> list[SNodeTree]:
    """The trees of fields that an object of this package and its parts have placed, each once."""
    found, seen, todo = [], set(), [thing]
    while todo:
        at = todo.pop()
        if id(at) in seen:
            continue
        seen.add(id(at))
        if isinstance(at, SNodeTree):
            found.append(at)
        elif isinstance(at, dict):
            todo += at.values()
        elif isinstance(at, (list, tuple)):
            todo += at
        elif type(at).__module__.split(".")[0] == "sim":
            todo += vars(at).values()
    return [tree for tree in found if not tree.destroyed]
