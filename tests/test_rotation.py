"""Rotations: identities between their four forms, the frame maps of equations 1.3, and scipy as a witness."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import rotation

RNG = np.random.default_rng(11)
ANGLES = np.column_stack(
    [RNG.uniform(-np.pi, np.pi, 500), RNG.uniform(-1.57, 1.57, 500), RNG.uniform(0, 2 * np.pi, 500)]
)
Q = rotation.from_euler(*ANGLES.T)

# (N, H, E) -> (N, E, D) and (E, N, U) -> (N, E, D); forward-up-right -> forward-right-down
NHE_TO_NED = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
ENU_TO_NED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])


def body_to_nhe(psi, theta, gamma):
    """A-2.2.B written out: R_y(psi) R_z(theta) R_x(gamma), psi counter-clockwise."""
    cp, sp, ct, st, cg, sg = (f(a) for a in (psi, theta, gamma) for f in (np.cos, np.sin))
    r_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    r_z = np.array([[ct, -st, 0], [st, ct, 0], [0, 0, 1]])
    r_x = np.array([[1, 0, 0], [0, cg, -sg], [0, sg, cg]])
    return r_y @ r_z @ r_x


def body_to_enu(psi, theta, gamma):
    """A-5.1.1 as it stands in the register, psi the heading."""
    cp, sp, ct, st, cg, sg = (f(a) for a in (psi, theta, gamma) for f in (np.cos, np.sin))
    return np.array(
        [
            [sp * ct, cp * sg - sp * cg * st, cp * cg + sp * sg * st],
            [cp * ct, -sp * sg - cp * cg * st, -sp * cg + cp * sg * st],
            [st, cg * ct, -sg * ct],
        ]
    )


def test_fixed_maps_between_the_frames_of_the_register():
    """Equations 1.3: one attitude, three formulations, to 1e-12 (G3)."""
    for roll, pitch, heading in ANGLES[:100]:
        C_nb = rotation.matrix(rotation.from_euler(roll, pitch, heading))
        assert_allclose(NHE_TO_NED @ body_to_nhe(-heading, pitch, roll) @ NHE_TO_NED.T, C_nb, atol=1e-12)
        assert_allclose(ENU_TO_NED @ body_to_enu(heading, pitch, roll) @ NHE_TO_NED.T, C_nb, atol=1e-12)


def test_quaternion_map_between_nhe_and_ned():
    """Equations 1.3: (l0, l1, l2, l3) in NHE/FUR is (q0, q1, -q3, q2) in NED/FRD."""
    for roll, pitch, heading in ANGLES[:100]:
        q = rotation.from_euler(roll, pitch, heading)
        nhe = rotation.matrix(np.array([q[0], q[1], -q[3], q[2]]))
        assert_allclose(nhe, body_to_nhe(-heading, pitch, roll), atol=1e-12)


def test_matrix_is_orthogonal_and_right_handed():
    C = rotation.matrix(Q)
    assert_allclose(C @ np.swapaxes(C, 1, 2), np.broadcast_to(np.eye(3), C.shape), atol=1e-14)
    assert_allclose(np.linalg.det(C), 1.0, atol=1e-14)


def test_round_trips():
    assert_allclose(np.transpose(rotation.to_euler(Q)), ANGLES, atol=1e-12)
    positive = np.where(Q[:, :1] < 0, -Q, Q)
    assert_allclose(rotation.from_matrix(rotation.matrix(Q)), positive, atol=1e-14)
    assert_allclose(rotation.from_rotvec(rotation.to_rotvec(Q)), positive, atol=1e-14)
    assert_allclose(rotation.from_scalar_last(rotation.to_scalar_last(Q)), Q, atol=0)


@pytest.mark.parametrize("heading", [-1e-17, -1e-300, -2e-16, 0.0, 2 * np.pi, np.nextafter(2 * np.pi, 0.0)])
def test_a_heading_lies_below_2_pi(heading):
    """The remainder of a tiny negative angle rounds to 2 pi itself: that is north, 0."""
    found = rotation.to_euler(np.array([np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)]))[2]
    assert 0.0 <= found < 2 * np.pi
    assert np.sin(found) == pytest.approx(heading if abs(heading) < 1 else 0.0, abs=4e-15)
    assert np.cos(found) == pytest.approx(1.0)


def test_half_turns_survive_the_matrix():
    """Where the trace is -1 the quaternion has w = 0; every axis must come back."""
    axes = np.vstack([np.eye(3), RNG.normal(size=(50, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    q = np.column_stack([np.zeros(len(axes)), axes])
    back = rotation.from_matrix(rotation.matrix(q))
    assert_allclose(np.abs(np.sum(back * q, axis=1)), 1.0, atol=1e-14)


def test_agrees_with_scipy():
    from scipy.spatial.transform import Rotation

    theirs = Rotation.from_euler("ZYX", ANGLES[:, ::-1])
    assert_allclose(theirs.as_matrix(), rotation.matrix(Q), atol=1e-12)
    quat = rotation.from_scalar_last(theirs.as_quat())
    assert_allclose(np.abs(np.sum(quat * Q, axis=1)), 1.0, atol=1e-12)
    assert_allclose(theirs.as_rotvec(), rotation.to_rotvec(Q), atol=1e-10)


def test_product_is_the_product_of_matrices_and_rotate_is_the_matrix():
    p, q = Q[:250], Q[250:]
    assert_allclose(
        rotation.matrix(rotation.multiply(p, q)), rotation.matrix(p) @ rotation.matrix(q), atol=1e-13
    )
    v = RNG.normal(size=(500, 3))
    assert_allclose(rotation.rotate(Q, v), np.einsum("kij,kj->ki", rotation.matrix(Q), v), atol=1e-13)
    assert_allclose(
        rotation.multiply(Q, rotation.conjugate(Q)), np.tile([1.0, 0, 0, 0], (500, 1)), atol=1e-14
    )


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.99e-4, 1.01e-4, 1.0, 3.1])
def test_rotation_vector_across_its_series(angle):
    """Within a dozen roundings: those of the axis, its norm, sine, cosine and arctangent."""
    axis = np.array([2.0, -1.0, 2.0]) / 3
    q = rotation.from_rotvec(angle * axis)
    assert_allclose(q, [np.cos(angle / 2), *(np.sin(angle / 2) * axis)], rtol=0, atol=2e-15)
    assert_allclose(rotation.to_rotvec(q), angle * axis, rtol=2e-15, atol=1e-30)


def test_skew_is_the_cross_product():
    u, v = RNG.normal(size=(2, 20, 3))
    assert_allclose(np.einsum("kij,kj->ki", rotation.skew(u), v), np.cross(u, v), atol=1e-15)


def test_continuous_undoes_sign_flips():
    angle = np.linspace(0, 20, 2000)
    smooth = np.column_stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)])
    flipped = smooth * np.where(RNG.random(2000) < 0.5, -1, 1)[:, None]
    back = rotation.continuous(flipped)
    assert np.abs(np.diff(back, axis=0)).max() < 0.01
    assert np.abs(np.diff(flipped, axis=0)).max() > 1
