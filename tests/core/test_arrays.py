"""Formulae for arrays of NumPy and of JAX, and immutable objects that become pytrees when JAX is imported."""

import dataclasses
import subprocess
import sys

import mpmath
import numpy as np
import pytest

from matcam import GGX, Camera, DiffractionOptics, GaussianOptics, HaloOptics, Sphere, rigs
from matcam.core.arrays import (
    changed,
    either,
    elementary,
    fft,
    first_axis_map,
    jacobian,
    last_of,
    linalg,
    repeated,
    special,
    xp,
)
from matcam.core.arrays.module import leaves_of, replaced
from matcam.core.jax import jax, jnp

_LATER = """
import sys
import matcam
lens = matcam.HaloOptics(matcam.GaussianOptics(0.5), 0.02, 30.0)
value = lens.mtf(0.25)
assert "jax" not in sys.modules
import jax
slope = jax.grad(lambda one: one.mtf(0.25))(lens)
assert type(slope) is matcam.HaloOptics
assert jax.jit(lens.mtf)(0.25).dtype == "float64"
print(float(value), float(slope.core.sigma), float(slope.fraction))
"""


def test_what_was_made_before_jax_is_a_pytree_after():
    done = subprocess.run([sys.executable, "-c", _LATER], capture_output=True, text=True, check=True)
    value, by_sigma, by_fraction = map(float, done.stdout.split())
    core = np.exp(-2 * (np.pi * 0.5 * 0.25) ** 2)
    assert value == pytest.approx(0.98 * core, rel=1e-12)
    assert by_sigma == pytest.approx(-0.98 * core * (2 * np.pi * 0.25) ** 2 * 0.5, rel=1e-12)
    assert by_fraction == pytest.approx(-core, rel=1e-12)


@pytest.mark.parametrize(
    "formula",
    [
        lambda x: GGX(0.1).d(x),
        lambda x: DiffractionOptics(8, 550e-9, 5e-6).mtf(x),
        lambda x: Camera(GaussianOptics(0.5)).psf(x, 0.2),
        lambda x: Camera(HaloOptics(GaussianOptics(0.5), 0.1, 4.0)).esf(x, 0.3),
        lambda x: rigs.merl().px_per_rad(x)[0],
        lambda x: Sphere(100.0, 5.0).highlight(x, 0.2),
    ],
)
def test_numpy_in_numpy_out_and_the_same_by_jax(formula):
    x = np.linspace(0.0, 0.4, 5)
    ours, theirs = formula(x), formula(jnp.asarray(x))
    assert isinstance(ours, np.ndarray)
    assert isinstance(theirs, jax.Array)
    np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-15)


def test_objects_are_immutable_and_compared_by_value():
    lens = GaussianOptics(0.5)
    with pytest.raises(dataclasses.FrozenInstanceError):
        lens.sigma = 1.0
    with pytest.raises(ValueError, match="read-only"):
        lens.sigma[...] = 1.0
    assert lens == GaussianOptics(0.5)
    assert lens != GaussianOptics(0.6)
    assert rigs.merl() == rigs.merl()
    halo = HaloOptics(lens, 0.1, 30.0)
    assert replaced(halo, "core.sigma", np.asarray(0.7)) == HaloOptics(GaussianOptics(0.7), 0.1, 30.0)
    assert (
        [float(leaf) for leaf in leaves_of(halo)] == [float(leaf) for leaf in jax.tree.leaves(halo)] == [0.5, 0.1, 30.0]
    )


def test_what_is_no_number_is_no_warning():
    assert np.isinf(xp.divide(1.0, np.zeros(2))).all()
    assert np.isnan(linalg.inv(np.zeros((2, 2)))).all()
    assert xp.pi == np.pi


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray])
def test_steps_and_derivatives(kind):
    x = kind([1.0, 2.0, 4.0])
    np.testing.assert_allclose(repeated(3, lambda state: (state[0] * 2,), (x,))[0], [8.0, 16.0, 32.0])
    np.testing.assert_allclose(first_axis_map(lambda one: one + 1, (x,), 2), [2.0, 3.0, 5.0])
    assert float(either(x[0] > 0, lambda a: a + 1, lambda a: a - 1, x[2])) == 5
    assert float(last_of(lambda total, one: (total + one, total), x[0], x)) == 4
    np.testing.assert_allclose(changed(x, 1, 7.0), [1.0, 7.0, 4.0])
    np.testing.assert_allclose(fft.irfft(fft.rfft(x), 3), x, rtol=1e-14)
    found = jacobian(lambda at: xp.stack([special.erf(at[0]) * at[1], xp.exp(-at[2])]), x)
    slope = 2 / np.sqrt(np.pi) * np.exp(-1)
    expected = [[slope * 2, special.erf(1.0), 0], [0, 0, -np.exp(-4.0)]]
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)


def test_the_error_function_of_compiled_programs_against_mpmath():
    x = np.concatenate([np.linspace(-7, 12, 400), [0.0, 1e-300, 30.0, 1000.0]])
    truth = np.array([float(mpmath.erfc(float(a))) for a in x])
    found = np.asarray(jax.jit(elementary.erfc)(jnp.asarray(x)))
    assert np.all(np.abs(found - truth) <= np.where(x < 6, 1e-14, 5e-14) * truth + 1e-300)
    assert float(jax.jit(elementary.erfc)(jnp.asarray(1e200))) == 0.0
    slopes = np.asarray(jax.vmap(jax.grad(elementary.erfc))(jnp.asarray(x)))
    np.testing.assert_allclose(slopes, -2 / np.sqrt(np.pi) * np.exp(-x * x), rtol=5e-14)
    np.testing.assert_allclose(elementary.erfc(x), truth, rtol=5e-14, atol=1e-300)


_MANY = np.geomspace(1e-12, 1e6, 400)


@pytest.mark.parametrize(
    ("found", "truth", "x", "error"),
    [
        (elementary.cosine, mpmath.cos, np.linspace(0, np.pi, 400), lambda _: 5e-16),
        (elementary.inverse_root, lambda x: 1 / mpmath.sqrt(x), _MANY, lambda y: 4e-16 * y),
        (elementary.logarithm, mpmath.log, np.r_[_MANY, 1 + np.linspace(-1e-3, 1e-3, 40), 1e-300, 1e300], lambda y: 5e-16 * y),
        (elementary.arcsinh, mpmath.asinh, np.r_[0.0, _MANY], lambda y: 5e-16 * (1 + y)),
        (lambda x: elementary.angle_of(x, 0.3), lambda x: mpmath.atan2(x, 0.3), np.r_[0.0, _MANY], lambda y: 5e-16 * y),
        (lambda x: elementary.angle_of(0.3, x), lambda x: mpmath.atan2(0.3, x), np.r_[0.0, _MANY], lambda y: 5e-16 * y + 5e-19),
        (lambda x: elementary.power(x, 0.7), lambda x: mpmath.power(x, 0.7), _MANY, lambda y: 2e-14 * y),
    ],
    ids=["cosine", "inverse_root", "logarithm", "arcsinh", "angle_of_y", "angle_of_x", "power"],
)  # fmt: skip
def test_elementary_functions_against_mpmath(found, truth, x, error):
    """Values of NumPy and of compiled programs, and derivatives."""
    expected = np.array([float(truth(mpmath.mpf(float(one)))) for one in x])
    compiled = np.asarray(jax.jit(found)(jnp.asarray(x)))
    assert np.all(np.abs(compiled - expected) <= error(np.abs(expected)))
    assert np.all(np.abs(found(x) - expected) <= 2 * error(np.abs(expected)))
    inner = x[(x > 1e-6) & (x < 1e5)]
    slopes = np.array([float(mpmath.diff(truth, mpmath.mpf(float(one)), h=1e-8 * one)) for one in inner])
    np.testing.assert_allclose(jax.vmap(jax.grad(found))(jnp.asarray(inner)), slopes, rtol=1e-6, atol=1e-12)


def test_the_angle_of_a_vector_without_direction():
    np.testing.assert_array_equal(elementary.angle_of(np.array([0.0, 1.0]), np.array([0.0, -1.0])), [0.0, np.pi / 2])


def test_the_power_differentiates_with_respect_to_its_exponent():
    slope = jax.grad(elementary.power, argnums=1)(2.0, 0.5)
    assert float(slope) == pytest.approx(np.log(2) * np.sqrt(2), rel=1e-14)
    second = jax.grad(jax.grad(elementary.power, argnums=1))(2.0, 0.5)
    assert float(second) == pytest.approx((1 + np.log(2) / 2) / np.sqrt(2), rel=1e-14)
