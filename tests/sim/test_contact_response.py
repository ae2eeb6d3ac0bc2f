"""The contact law: against its float64 twin, and what must hold of every contact whatever its effective mass."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.support.reference_contact import contact_impulse, dot, holding_impulse, split

N, DT = 512, 1e-3
FRICTIONS = [0.0, 0.3, 1.0]


def random_contacts(seed: int = 3) -> dict[str, np.ndarray]:
    """Normals n, motions y, impulses before, and effective masses H = A^-1, from nearly isotropic to 100 : 1."""
    rng = np.random.default_rng(seed)
    n = rng.normal(size=(N, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    turns = Rotation.random(N, rng).as_matrix()
    H = np.einsum("kij,kj,klj->kil", turns, 10.0 ** rng.uniform(-1, 1, (N, 3)), turns)
    y, old = rng.normal(size=(N, 3)), rng.normal(size=(N, 3))
    return {"n": n, "y": y, "old": old, "H": H, "A": np.linalg.inv(H), "w": rng.uniform(0.5, 2.0, (N, 2))}


@pytest.fixture(scope="module")
def device(ti_cpu):
    """The law on the device: impulse(n, holding, A, mu_s, mu_k), and held(n, y, old, w, least, spring)."""
    ti = ti_cpu
    from sim.contact.response import (
        contact_impulse,
        fingertip_spring,
        holding_impulse,
        isotropic_contact_impulse,
        min_normal_motion,
    )
    from sim.state import inverse_mass_matrix

    n, vector, other, out = (ti.Vector.field(3, ti.f32, N) for _ in range(4))
    matrix, pair = ti.Matrix.field(3, 3, ti.f32, N), ti.Vector.field(2, ti.f32, N)
    scalar, spring = ti.field(ti.f32, N), ti.Vector.field(3, ti.f32, ())

    @ti.kernel
    def solve(mu_s: ti.f32, mu_k: ti.f32):
        for k in range(N):
            A = matrix[k]
            out[k] = contact_impulse(vector[k], n[k], A @ n[k], A.trace() / 3.0, ti.Vector([mu_s, mu_k]), DT)

    @ti.kernel
    def solve_isotropic(mu: ti.f32):
        for k in range(N):
            out[k] = isotropic_contact_impulse(vector[k], n[k], pair[k][0], ti.Vector([mu, mu]), DT)

    @ti.kernel
    def hold(least: ti.f32):
        for k in range(N):
            c = spring[None]
            out[k] = holding_impulse(other[k], n[k], vector[k], least, pair[k][0], pair[k][1], c[0], c[1], c[2])

    @ti.kernel
    def press(frames: ti.i32):
        """A finger at `scalar` from bodies at rest, of inverse mass pair[0], pushes them away."""
        for k in range(N):
            phi, y, old, up = scalar[k], 0.0, ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 1.0, 0.0])
            for _ in range(frames):
                w = pair[k][0]
                least, compliance, damping = fingertip_spring(phi, DT)
                new = holding_impulse(old, up, (y + w * old[1]) * up, least, w, w, compliance, damping, 1e30)
                new = isotropic_contact_impulse(new, up, w, ti.Vector([0.0, 0.0]), DT)
                y, old = y + w * new[1], new
                phi += y
                out[k] = ti.Vector([phi, ti.max(out[k][1], y / DT), new[1]])

    @ti.kernel
    def least_motion():
        for k in range(N):
            scalar[k] = min_normal_motion(scalar[k], DT)

    @ti.kernel
    def mass_matrix(inv_mass: ti.f32):
        for k in range(N):
            matrix[k] = inverse_mass_matrix(vector[k], inv_mass, matrix[k])

    def take(**values):
        fields = {"n": n, "vector": vector, "other": other, "matrix": matrix, "pair": pair, "scalar": scalar}
        for name, value in values.items():
            fields[name].from_numpy(value.astype(np.float32))

    def result(kernel, field, *arguments, **values):
        take(**values)
        kernel(*arguments)
        return field.to_numpy().astype(np.float64)

    class Device:
        @staticmethod
        def impulse(normals, holding, A, mu_s, mu_k=None):
            return result(solve, out, mu_s, mu_s if mu_k is None else mu_k, n=normals, vector=holding, matrix=A)

        @staticmethod
        def isotropic_impulse(normals, holding, w, mu):
            return result(solve_isotropic, out, mu, n=normals, vector=holding, pair=w)

        @staticmethod
        def held(normals, y, old, w, least, compliance=0.0, damping=1.0, most=1e30):
            spring[None] = (compliance, damping, most)
            return result(hold, out, least, n=normals, vector=y, other=old, pair=w)

        @staticmethod
        def pressed(phi, mass, steps):
            out.fill(0.0)
            return result(press, out, steps, scalar=phi, pair=np.stack([1 / mass, 1 / mass], 1)).T

        @staticmethod
        def inverse_mass(arm, inv_mass, inverse_inertia):
            return result(mass_matrix, matrix, inv_mass, vector=arm, matrix=inverse_inertia)

        @staticmethod
        def least_motion(phi):
            return result(least_motion, scalar, scalar=phi)

    return Device


def solved(device, friction: float, least: float = 0.0):
    """Random contacts, what would hold them, their impulses, and the motions after."""
    c = random_contacts()
    y_n, y_t = split(c["y"], c["n"])
    holding = np.einsum("kij,kj->ki", c["H"], (least - y_n)[:, None] * c["n"] - y_t)
    p = device.impulse(c["n"], holding, c["A"], friction)
    return c, holding, p, c["y"] + np.einsum("kij,kj->ki", c["A"], p)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_impulses_are_those_of_the_twin(device, friction):
    c, holding, p, _ = solved(device, friction)
    scale = np.linalg.norm(holding, axis=1).max()
    assert_allclose(p, contact_impulse(holding, c["n"], c["A"], friction), atol=2e-5 * scale)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_with_an_isotropic_mass_impulses_are_those_of_the_twin(device, friction):
    c, holding, _, _ = solved(device, friction)
    p = device.isotropic_impulse(c["n"], holding, c["w"], friction)
    scale = np.linalg.norm(holding, axis=1).max()
    expected = contact_impulse(holding, c["n"], c["w"][:, :1, None] * np.eye(3), friction)
    assert_allclose(p, expected, atol=2e-5 * scale)
    assert (dot(expected, c["n"]) > 0).sum() > 100 and (dot(expected, c["n"]) == 0).sum() > 100


@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("least", [-0.3, 0.0, 0.2])
def test_nothing_penetrates_and_nothing_is_pulled(device, friction, least):
    """Signorini: n . y' >= least, n . p >= 0, and one of the two is an equality."""
    c, _, p, after = solved(device, friction, least)
    normal, excess = dot(p, c["n"]), dot(after, c["n"]) - least
    assert normal.min() >= 0.0 and excess.min() > -1e-4
    assert np.minimum(normal, excess).max() < 1e-4
    assert (normal > 0).sum() > 100 and (normal == 0).sum() > 100


@pytest.mark.parametrize("friction", FRICTIONS)
def test_contacts_stick_in_coulombs_cone_or_slide_on_its_edge(device, friction):
    c, _, p, after = solved(device, friction)
    normal, tangential = split(p, c["n"])
    size, slip = np.linalg.norm(tangential, axis=1), np.linalg.norm(split(after, c["n"])[1], axis=1)
    touching = normal > 0
    assert (size <= friction * normal + 1e-4).all()
    sticks, slides = touching & (slip < 1e-4), touching & (slip > 1e-3)
    assert (sticks | slides)[touching].all()
    assert slides.sum() > 20 and (sticks.sum() > 20 or friction < 1.0)
    assert_allclose(size[slides], friction * normal[slides], rtol=1e-3, atol=1e-5)
    power = dot(tangential, after)
    assert (power[slides] < 1e-5).all()  # friction never drives


@pytest.mark.parametrize("friction", FRICTIONS)
def test_energy_is_only_taken_and_no_push_is_larger_than_what_holds(device, friction):
    """Whatever the coupling: a stiff vertex that can slide only if it rises is neither jammed nor thrown."""
    c, holding, p, after = solved(device, friction)
    before, now = (0.5 * np.einsum("ki,kij,kj->k", y, c["H"], y) for y in (c["y"], after))
    assert (now <= before * (1 + 1e-4)).all()
    A_n = np.einsum("kij,kj->ki", c["A"], c["n"])
    frictionless = dot(A_n, holding) / dot(A_n, c["n"])
    most = np.maximum(frictionless, dot(holding, c["n"]))
    assert (dot(p, c["n"]) <= np.maximum(most, 0) * (1 + 1e-4) + 1e-5).all()


def test_friction_falls_from_the_static_to_the_kinetic_coefficient(device):
    """At the cone's edge mu_s holds what mu_k would not; at 1 m/s of slip mu_k is left, and a mean between."""
    from sim.contact.response import KINETIC_FRICTION_SPEED

    n = np.tile([0.0, 1.0, 0.0], (N, 1))
    slip = np.linspace(0, 2 * KINETIC_FRICTION_SPEED * DT, N)
    holding = np.stack([0.5e-3 + slip, np.full(N, 1e-3), 0 * slip], axis=1)  # mu_s n . p is 0.5e-3
    p = device.impulse(n, holding, np.tile(np.eye(3), (N, 1, 1)), 0.5, 0.2)
    mu = 0.5 - 0.3 * np.minimum(slip / (KINETIC_FRICTION_SPEED * DT), 1)
    assert_allclose(p[:, 0], 1e-3 * mu, rtol=1e-3)
    assert_allclose(p[:, 1], 1e-3, rtol=1e-5)


@pytest.mark.parametrize("spring", [(0.0, 1.0, 1e30), (0.7, 5.0, 1e30), (0.7, 5.0, 0.1)])
def test_holding_impulses_are_those_of_the_twin(device, spring):
    c = random_contacts()
    p = device.held(c["n"], c["y"], c["old"], c["w"], 0.1, *spring)
    expected = holding_impulse(c["old"], c["n"], c["y"], 0.1, *c["w"].T, *spring)
    assert_allclose(p, expected, atol=1e-5)


def test_the_least_motion_closes_gaps_rests_in_the_slop_and_recovers_slowly(device):
    from sim.contact.response import CONTACT_SLOP, MAX_RECOVERY_SPEED

    phi = np.linspace(-0.05, 0.01, N)
    least = device.least_motion(phi)
    apart, deep = phi > 0, phi < -2 * CONTACT_SLOP
    assert_allclose(least[apart], -(phi + CONTACT_SLOP)[apart], rtol=1e-4)  # it may come to the slop, not further
    assert (least[~apart] >= 0).all() and least.max() <= MAX_RECOVERY_SPEED * DT * 1.0001
    assert (phi + least)[deep].max() < 1e-9 and (np.diff(least[deep]) < 1e-9).all()  # the deeper, the faster
    assert least[phi < -5e-5].min() > 0  # [m]; deeper than that nothing rests
    at_rest = device.least_motion(np.linspace(-2 * CONTACT_SLOP, 0, N))
    assert_allclose(at_rest, 0, atol=1e-9)


def test_contacts_recover_and_slip_as_fast_as_they_should(device):
    """They rest 15 to 28 um deep at most: far from what is seen, and from rounding (0.1 um a metre away).

    Of a millimetre a third is left after 20 ms, two frames of a headset; from deep inside it goes at 1 m/s, as fast as
    after a fall from 5 cm. Half of what friction loses in sliding it has lost at 1 cm/s.
    """
    phi = np.linspace(-5e-5, 0, N)
    assert 1.5e-5 < -phi[device.least_motion(phi) > 0].max() < 2.8e-5
    left = np.full(N, -1e-3)
    for _ in range(round(0.02 / DT)):
        left = left + device.least_motion(left)
    assert 0.25 < -left.max() / 1e-3 < 0.5
    assert 0.7 < device.least_motion(np.full(N, -0.1)).max() / DT < 1.4
    n = np.tile([0.0, 1.0, 0.0], (N, 1))
    holding = np.tile([0.5e-3 + 0.01 * DT, 1e-3, 0.0], (N, 1))
    assert_allclose(device.impulse(n, holding, np.tile(np.eye(3), (N, 1, 1)), 0.5, 0.2)[:, 0], 0.35e-3, rtol=0.15)


def test_the_inverse_mass_matrix_is_the_motion_for_a_unit_impulse(device):
    """dx = p / m and rotation I^-1 (r x p), so the point at r moves by dx + rotation x r."""
    c, m = random_contacts(), 0.7
    got = device.inverse_mass(c["y"], m, c["A"])
    p = c["old"]
    expected = m * p + np.cross(np.einsum("kij,kj->ki", c["A"], np.cross(c["y"], p)), c["y"])
    assert_allclose(np.einsum("kij,kj->ki", got, p), expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_a_finger_pushes_out_slowly_whatever_it_meets(device):
    """From up to 5 cm deep, bodies of 1 g to 1 kg: out, but no faster than anything else recovers."""
    from sim.contact.response import MAX_RECOVERY_SPEED

    depth, mass = np.linspace(0.001, 0.05, N), 10.0 ** np.random.default_rng(1).uniform(-3, 0, N)
    phi, fastest, impulse = device.pressed(-depth, mass, 400)
    assert (fastest < 1.02 * MAX_RECOVERY_SPEED).all() and fastest.max() > 0.5 * MAX_RECOVERY_SPEED
    assert (impulse >= 0).all()
    assert (phi > -depth / 2).all()


def test_a_fingertip_yields_a_millimetre_to_three_newtons(device):
    """The two to four samples of one that touch."""
    _, _, impulse = device.pressed(np.full(N, -1e-3), np.full(N, 1e9), 50)
    force = impulse / DT**2
    assert (force > 3 / 4).all() and (force < 3 / 2).all()
