"""Friction models against what their equations give in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hydro_env import PlantParameters
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.linearisation import linearise
from hydro_env.plant.parts.friction import friction
from hydro_env.plant.states import STATE_NAMES

LUGRE = PlantParameters().replace(friction={"model": "lugre"})
C = plant_coefficients(LUGRE)
F = LUGRE.friction


def sliding_force(velocity):
    """g(v) of Stribeck: the force of steady sliding."""
    return F.coulomb_force + (F.breakaway_force - F.coulomb_force) / (1.0 + (velocity / F.stribeck_velocity) ** 2)


@pytest.mark.parametrize("velocity", [-0.2, -0.01, 1e-4, 0.003, 0.1])
def test_steady_sliding_is_stribecks(velocity):
    deflection = math.copysign(sliding_force(velocity), velocity) / F.bristle_stiffness
    force, rate = friction(velocity, deflection, C)
    assert rate == pytest.approx(0.0, abs=1e-12)
    assert force == pytest.approx(math.copysign(sliding_force(velocity), velocity), rel=1e-12)
    stribeck = plant_coefficients(PlantParameters())
    smooth = velocity / F.transition_velocity
    expected = sliding_force(velocity) * smooth / math.sqrt(1.0 + smooth**2)
    assert friction(velocity, 0.0, stribeck) == (pytest.approx(expected, rel=1e-12), 0.0)


def test_bristles_bend_as_the_exponential_of_constant_speed():
    """z(t) = (g/σ_0) (1 − exp(−σ_0 |v| t / g)): breakaway within a few g/(σ_0 v)."""
    velocity, deflection, step = 2e-3, 0.0, 1e-5
    level = sliding_force(velocity)
    for number in range(40_000):
        time = number * step
        expected = level / F.bristle_stiffness * -math.expm1(-F.bristle_stiffness * velocity * time / level)
        if number % 1_000 == 0:
            assert deflection == pytest.approx(expected, rel=1e-3, abs=1e-12)
        _, first = friction(velocity, deflection, C)
        _, second = friction(velocity, deflection + 0.5 * step * first, C)
        deflection += step * second
    assert deflection * F.bristle_stiffness == pytest.approx(level, rel=1e-6)


@settings(max_examples=15, deadline=None)
@given(
    amplitude=st.floats(1e-5, 0.3), second=st.floats(0.0, 1.0), frequency=st.floats(1.0, 200.0), phase=st.floats(0.0, 6)
)
def test_friction_gives_back_no_more_than_it_has_stored(amplitude, second, frequency, phase):
    """∫ F v dt ≥ −stored energy at the start (none), along any motion (σ_1 small; Canudas de Wit et al. 1995)."""
    time = np.linspace(0.0, 4.0 / frequency, 3_000)
    step = time[1] - time[0]
    turn = 2 * math.pi * frequency * time
    speeds = amplitude * (np.sin(turn) + second * np.sin(2.7 * turn + phase))
    deflection, work = 0.0, 0.0
    for velocity in speeds.tolist():
        force, _ = friction(velocity, deflection, C)
        work += force * velocity * step
        assert work > -1e-5 * F.breakaway_force * amplitude / frequency
        # exact over the step, as velocity is constant in it
        decay = C.bristle_stiffness * abs(velocity) / sliding_force(velocity)
        settled = math.copysign(sliding_force(velocity), velocity) / C.bristle_stiffness if velocity else 0.0
        deflection = settled + (deflection - settled) * math.exp(-decay * step) if velocity else deflection
    assert abs(deflection) <= F.breakaway_force / F.bristle_stiffness * (1 + 1e-9)


def test_at_rest_the_bristles_are_a_spring():
    axis = linearise(LUGRE, position=0.02)
    velocity, bristle = STATE_NAMES.index("velocity"), STATE_NAMES.index("bristle_deflection")
    mass = LUGRE.load.mass + LUGRE.cylinder.piston_mass
    assert axis.a[velocity, bristle] == pytest.approx(-F.bristle_stiffness / mass, rel=1e-6)
    damping = -(axis.a[velocity, velocity] * mass) - LUGRE.load.viscous_damping
    assert damping == pytest.approx(F.bristle_damping, rel=1e-3)
    assert axis.a[bristle, velocity] == pytest.approx(1.0, rel=1e-3)
