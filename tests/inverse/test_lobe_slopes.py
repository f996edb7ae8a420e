"""Fits side by side are the fits alone."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from matcam import fit, rigs
from matcam.core.jax import jax
from matcam.core.workspace import default_workspace
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.lobe_slopes import RecordBatch, record_and_slopes
from matcam.inverse.operator.lobe_operator import lobe_operator
from matcam.inverse.operator.rig_axes import free_axis, shape_axis
from matcam.material.ndf.free_lobe import KNOTS
from tests.inverse import recorded as made
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor


@pytest.fixture(scope="module")
def operator():
    return lobe_operator(rigs.merl(), "centre", 30)[1]


@pytest.mark.parametrize(
    ("kind", "lobe"),
    [
        pytest.param(LobeKind("epd", "van-ginneken"), np.log([0.01, 0.7]), marks=pytest.mark.slow),
        (LobeKind("ggx", "smith", bends=KNOTS), [np.log(0.01), *np.linspace(-0.5, 0.7, KNOTS) ** 2]),
    ],
)
def test_slopes_are_differences_of_the_record(kind, lobe):
    """Of the record that the operator makes of the lobe itself, by the lobe's coordinates and the rig's.

    Lambda's table moves with the roughness, and is right to 1e-6.
    """
    axes = (free_axis("optics.sigma_px", rigs.merl()), shape_axis())
    _, operator = lobe_operator(rigs.merl(), "centre", 30, axes)
    q = np.array([*lobe, 0.1, -0.2])
    record = jax.jit(lambda q: operator.record(kind.ndf(q[: kind.size]), kind.masking, q[kind.size :]))
    value, slopes = record_and_slopes(operator, kind, q)
    np.testing.assert_allclose(value, record(q), rtol=1e-12, atol=1e-15 * np.abs(value).max())
    step = 1e-3
    for place, slope in enumerate(slopes):
        near, far = (
            (record(q + n * step * np.eye(q.size)[place]) - record(q - n * step * np.eye(q.size)[place]))
            / (2 * n * step)
            for n in (1, 2)
        )
        np.testing.assert_allclose(slope, (4 * near - far) / 3, rtol=1e-5, atol=1e-6 * np.abs(value).max())


@pytest.mark.slow
def test_questions_of_several_threads_are_answered_as_alone(operator):
    questions = [("ggx", np.log([a])) for a in (0.001, 0.01, 0.1)] + [("gaussian", np.log([0.02]))]
    alone = [record_and_slopes(operator, LobeKind(family, "smith"), q) for family, q in questions]
    with RecordBatch(3) as batch, ThreadPoolExecutor(4) as pool:

        def asked(question):
            return record_and_slopes(operator, LobeKind(question[0], "smith"), question[1], batch)

        together = list(pool.map(asked, questions))
        assert sum(batch.sizes) == 4
        assert max(batch.sizes) <= 3
        wrong = pool.submit(asked, ("no family", np.zeros(1)))
        with pytest.raises(KeyError):
            wrong.result()
    for ours, truth in zip(together, alone, strict=True):
        for a, b in zip(ours, truth, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-12 * np.abs(b).max())
    assert (
        record_and_slopes(operator, LobeKind(questions[0][0], "smith"), questions[0][1])[0].shape == alone[0][0].shape
    )


@pytest.mark.slow
def test_fits_side_by_side_are_the_fits_alone():
    shot, every = made.pictures(18), 18
    light = [
        shot.rule.ways(oracle.GGX(a)) * conductor(shot.cells.theta_d, *made.CHROMIUM)[:, None, None]
        for a in (0.002, 0.02)
    ]
    tables = [shot.table(shot.rule.noisy(one, np.random.default_rng(seed))) for seed, one in enumerate(light)]
    alone = [fit(table, made.rig(), noise=made.NOISE, every=every) for table in tables]
    with RecordBatch(2) as batch, ThreadPoolExecutor(2) as pool:

        def fitted(table):
            workspace = default_workspace().with_batch(batch)
            return fit(table, made.rig(), noise=made.NOISE, every=every, workspace=workspace)

        together = list(pool.map(fitted, tables))
    assert max(batch.sizes) == 2
    for ours, truth in zip(together, alone, strict=True):
        np.testing.assert_allclose(list(ours.params.values()), list(truth.params.values()), rtol=1e-6)
        np.testing.assert_allclose(ours.covariance, truth.covariance, rtol=1e-4)
