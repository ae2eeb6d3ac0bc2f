"""The rows of the physics table for bodies in contact, in the form of bench/physics.py."""

from bench.physics import row
from bench.physics_contact import rigid_bounce, rigid_stack, slope
from bench.piles import resting_pile
from bench.playground import playground
from bench.throws import linked_throws

GAIN = 1e-5  # [J]; it lifts a cube of the pile by 2 um


def ring_throws(count: int = 100, **how) -> list[dict]:
    """Rings thrown on their pegs at up to 5 m/s, none of which may get loose."""
    return [row(f"rings that stay on their peg, of {count}", count, linked_throws(count, 5.0, **how), 0.0)]


def pile_at_rest(seconds: float = 60.0) -> list[dict]:
    """A pile that has settled gains no energy."""
    gained = resting_pile(seconds)["gained"]
    return [row(f"pile at rest, energy gained in {seconds:g} s [J]", 0.0, gained, GAIN, error=gained)]


def rigid_bodies() -> list[dict]:
    """Rebounds, a stack of five and a slope, all in one solver."""
    place = playground()
    return [*rigid_bounce(place), *rigid_stack(place), *slope(place)]
