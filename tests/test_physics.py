"""The physics table, the rows without contact, on the CPU."""

import pytest

from tests import physics

pytestmark = pytest.mark.usefixtures("ti_cpu")


@pytest.mark.parametrize("measure", physics.ALL, ids=lambda f: f.__name__)
def test_the_table_holds(measure):
    rows = measure()
    assert rows
    for r in rows:
        print(f"{r['check']:45s} reference {r['reference']:<12.6g} measured {r['measured']:.6g}")
    assert not [r for r in rows if not r["pass"]]


def test_undamped_motion_never_gains_energy():
    """Elastic energy starts at zero, so no later kinetic energy may exceed the first."""
    assert physics.long_run()[0]["pass"]
