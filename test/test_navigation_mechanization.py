"""Mechanizations against exact truth, and their error equations against finite differences; the paper's errata."""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import central_difference
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from simulation_support import close

from mems_ins_fusion.navigation import planar, strapdown
from mems_ins_fusion.navigation.earth import gravity, radii
from mems_ins_fusion.simulation.drive import simulate_drive

DT = 0.01


def test_planar_mechanization_follows_the_exact_drive():
    # given perfect sensors on a level road that does not rotate
    drive = simulate_drive(80.0, 3, 100.0)
    v_n, v_e, yaw = *drive.velocity[0, :2], drive.yaw[0]
    position, states = np.zeros(2), []
    for f, w in zip(drive.specific_force[1:], drive.angular_rate[1:]):
        north, east, v_n, v_e, yaw = planar.mechanize(v_n, v_e, yaw, f[0], f[1], w[2], DT)
        position += north, east
        states.append((*position, v_n, v_e, yaw))
    states = np.array(states)
    # then yaw and velocity are exact, and position to the rounding off of a trapezoid: dt^2/12 da/dt, summed up
    assert close(states[:, 4], drive.yaw[1:], 1e-10)
    assert close(states[:, 2:4], drive.velocity[1:, :2], 1e-9)
    jump = np.abs(np.diff(drive.velocity, axis=0)).max()
    assert close(states[:, :2], drive.position[1:, :2] - drive.position[0, :2], DT / 6 * jump)


def test_strapdown_mechanization_follows_the_exact_drive_on_the_rotating_earth():
    drive = simulate_drive(80.0, 3, 100.0, hills=True, rotating_earth=True, pitch_per_acceleration=0.01,
                           roll_per_acceleration=0.02)
    latitude, longitude, height = drive.latitude[0], drive.longitude[0], drive.height[0]
    x, y, z, w = drive.attitude[0].as_quat()
    q, v = (w, x, y, z), tuple(drive.velocity[0])
    error = []
    for k in range(1, len(drive.time)):
        meridian, prime_vertical = (r + height for r in radii(latitude))
        rates = strapdown.frame_rates(latitude, v[0], v[1], meridian, prime_vertical)
        q, _, _, moved, v = strapdown.mechanize(q, *v, tuple(drive.specific_force[k]), tuple(drive.angular_rate[k]), DT,
                                                gravity(latitude, height), rates)
        latitude += moved[0] / meridian
        longitude += moved[1] / (prime_vertical * math.cos(latitude))
        height -= moved[2]
        error.append(((latitude - drive.latitude[k]) * meridian, (longitude - drive.longitude[k]) * prime_vertical,
                      height - drive.height[k], *(v - drive.velocity[k])))
    turned = Rotation.from_quat([*q[1:], q[0]]) * drive.attitude[-1].inv()
    # then what is left after 80 s is second order in the interval; without earth rate and Coriolis it would be
    # 7.3e-5 rad/s and 1.5e-4 x 10 m/s^2, over 80 s
    assert turned.magnitude() < 1e-7
    assert np.abs(error)[:, 3:].max() < 2e-4
    assert np.abs(error)[:, :3].max() < 0.03


def test_strapdown_mechanization_solves_its_differential_equation():
    # given constant specific force and angular rate in b for 2 s, integrated by a Runge-Kutta method of high order
    f, w, g = np.array([1.0, -2.0, -9.0]), np.array([0.2, -0.3, 0.5]), 9.81
    start = Rotation.from_euler('ZYX', [0.5, 0.1, -0.2])
    rates = strapdown.frame_rates(0.8, 15.0, -8.0, 6.37e6, 6.39e6)
    e_n, e_d, t_n, t_e, t_d = rates
    turn, coriolis = np.array([e_n + t_n, t_e, e_d + t_d]), np.array([2 * e_n + t_n, t_e, 2 * e_d + t_d])

    def derivative(_, y):
        c = y[6:].reshape(3, 3)
        return np.concatenate([y[3:6], c @ f + [0, 0, g] - np.cross(coriolis, y[3:6]),
                               (c @ np.cross(np.eye(3), w) - np.cross(np.eye(3), turn) @ c).ravel()])

    y0 = np.concatenate([np.zeros(3), [15.0, -8.0, 0.1], start.as_matrix().ravel()])
    exact = solve_ivp(derivative, (0, 2), y0, method='DOP853', rtol=1e-12, atol=1e-12).y[:, -1]
    errors = []
    for n in (100, 200):
        x, y, z, s = start.as_quat()
        q, v, r = (s, x, y, z), (15.0, -8.0, 0.1), np.zeros(3)
        for _ in range(n):
            q, _, _, moved, v = strapdown.mechanize(q, *v, tuple(f), tuple(w), 2 / n, g, rates)
            r += moved
        c = np.reshape(strapdown.matrix(q), (3, 3))
        errors.append(np.abs(np.concatenate([r, v, c.ravel()]) - exact))
    # then attitude is exact, the rest of second order in the interval (Coriolis of first order, but tiny)
    assert errors[1][6:].max() < 1e-12
    assert errors[1].max() < 1e-4
    assert np.linalg.norm(errors[1]) / np.linalg.norm(errors[0]) == pytest.approx(0.25, abs=0.02)


# --- the error equations ---

V_N, V_E, YAW, F_X, F_Y, W_Z = 9.0, -14.0, 1.1, 1.7, -2.3, 0.4


def planar_finite_difference(dt=DT):
    """Columns r_n, r_e, v_n, v_e, yaw, f_x, f_y, w_z; rows r_n to yaw."""
    def after(e):
        north, east, v_n, v_e, yaw = planar.mechanize(V_N + e[2], V_E + e[3], YAW + e[4], F_X + e[5], F_Y + e[6],
                                                      W_Z + e[7], dt)
        return e[0] + north, e[1] + east, v_n, v_e, yaw
    return central_difference(after, 8, 1e-4)


def planar_error_matrix(dt=DT):
    f_n, f_e, c, s = planar.rotate(YAW, dt, F_X, F_Y, W_Z)
    return np.column_stack([planar.error_step(dt, f_n, f_e, c, s, *column) for column in np.eye(8)])


@pytest.mark.parametrize('dt', [0.0025, 0.01, 0.5])
def test_planar_transition_is_the_derivative_of_the_mechanization(dt):
    # a cubic remainder h^2 / 6 and rounding eps / h
    assert planar_error_matrix(dt) == pytest.approx(planar_finite_difference(dt), abs=2e-8)


def test_erratum_eq_18_column_5_the_entries_have_opposite_signs():
    # given the finite difference of rows dv_n, dv_e, column dyaw
    column = planar_finite_difference()[2:4, 4]
    f_n, f_e, _, _ = planar.rotate(YAW, DT, F_X, F_Y, W_Z)
    assert column == pytest.approx([-f_e * DT, f_n * DT], abs=1e-8)
    # then both entries negative, as printed, are wrong whichever specific force a_x and a_y may be
    for a in ((f_n, f_e), (f_e, f_n), (F_X, F_Y), (F_Y, F_X)):
        assert np.abs(column + np.array(a) * DT).max() > 0.5 * DT


def test_erratum_eq_18_positions_are_in_metres():
    # given the derivative of latitude, in radians, by the velocity
    meridian = radii(0.84)[0]

    def latitude(e):
        return (planar.mechanize(V_N + e[0], V_E, YAW, F_X, F_Y, W_Z, DT)[0] / meridian,)
    in_radians = central_difference(latitude, 1, 1.0)[0, 0]
    # then the printed entry dt holds for metres, and is wrong by the radius of the earth for radians
    assert planar_error_matrix()[0, 2] == DT == pytest.approx(in_radians * meridian)
    assert DT / in_radians > 6e6


def phi_of(q, reference):
    a, b = (Rotation.from_quat([*p[1:], p[0]]) for p in (q, reference))
    return (a * b.inv()).as_rotvec()


def strapdown_matrices(rates, dt=DT):
    """Implemented and finite-difference transition: rows r, v, phi, columns those, then f and w."""
    q0 = strapdown.from_euler(0.1, -0.2, 1.1)
    v, f, w = np.array([9.0, -14.0, 0.4]), np.array([1.7, -2.3, -9.5]), np.array([0.1, -0.2, 0.4])
    nominal, c, f_level, _, _ = strapdown.mechanize(q0, *v, tuple(f), tuple(w), dt, 9.81, rates)

    def after(e):
        q = strapdown.multiply(strapdown.from_rotation_vector(*e[6:9]), q0)
        q, _, _, moved, velocity = strapdown.mechanize(q, *(v + e[3:6]), tuple(f + e[9:12]), tuple(w + e[12:15]), dt,
                                                       9.81, rates)
        return np.concatenate([e[:3] + moved, velocity, phi_of(q, nominal)])

    columns = np.eye(15).reshape(15, 5, 3)
    step = strapdown.transition(dt, c, f_level)
    implemented = np.column_stack([strapdown.error_step(step, *(tuple(part) for part in column))
                                   for column in columns])
    return implemented, central_difference(after, 15, 1e-4)


def test_strapdown_transition_is_the_derivative_of_the_mechanization():
    implemented, difference = strapdown_matrices((0.0,) * 5)
    # attitude noise acts at mid-interval: exact to the turn within a quarter of an interval
    within = 0.25 * DT * 0.5
    bound = np.full((9, 15), 3e-8)
    bound[:6, 12:] += within * np.abs(implemented[:6, 12:]).max(axis=1, keepdims=True)
    bound[6:, 12:] += DT * (DT * 0.5) ** 2
    assert np.all(np.abs(implemented - difference) < bound)


def test_strapdown_transition_leaves_out_only_the_rates_of_the_frame():
    rates = strapdown.frame_rates(0.84, 9.0, -14.0, 6.37e6, 6.39e6)
    implemented, difference = strapdown_matrices(rates)
    still, _ = strapdown_matrices((0.0,) * 5)
    omitted = np.abs(implemented - difference)
    assert omitted[3:6, 3:6].max() > 1e-7  # Coriolis, and no more than it
    assert omitted.max() < 2 * 7.3e-5 * 10 * DT + 2e-5
    assert implemented == pytest.approx(still, abs=1e-5)


def test_a_yaw_error_is_the_same_in_both_mechanizations():
    # given a level vehicle: the down component of phi is the planar yaw error
    q = strapdown.from_euler(0.0, 0.0, YAW)
    _, c, f_level, _, _ = strapdown.mechanize(q, V_N, V_E, 0.0, (F_X, F_Y, -9.8), (0.0, 0.0, W_Z), DT, 9.8, (0.0,) * 5)
    step = strapdown.transition(DT, c, f_level)
    strap = strapdown.error_step(step, (0.0,) * 3, (0.0,) * 3, (0.0, 0.0, 1.0), (0.0,) * 3, (0.0,) * 3)
    flat = planar_error_matrix()[:, 4]
    assert [strap[i] for i in (0, 1, 3, 4, 8)] == pytest.approx(flat, abs=1e-15)
