"""The e-SFR of ISO 12233, and numbers that are read off an edge. Truth: `tests/oracle/slanted_edge.py`."""

import numpy as np
import pytest

from matcam import edge_mtf
from matcam.calibration import iso12233_sfr, level_frequency, mtf_at, rise_distance
from matcam.core.errors import ArgumentError, FitError
from matcam.files.photographs import read_photograph
from tests.oracle import processed_pictures as software
from tests.oracle import slanted_edge as oracle

ELECTRONS = 1e4


@pytest.mark.parametrize("sigma", [0.3, 0.5, 0.8, 1.2])
def test_response_of_a_known_lens(sigma):
    found = iso12233_sfr(oracle.picture(oracle.gaussian(sigma)) * ELECTRONS)
    below = found.frequency <= 0.5
    # bins of a quarter of a px are a blur that the standard does not undo: sinc(f / 4)
    truth = oracle.gaussian_mtf(found.frequency, sigma) * np.sinc(found.frequency * found.spacing)
    assert np.max(np.abs(found.sfr - truth)[below]) < 0.004
    assert found.frequency[-1] == pytest.approx(1.0, abs=0.02)
    assert np.degrees(found.slope) == pytest.approx(5, abs=0.02)
    assert found.spacing == pytest.approx(np.cos(np.radians(5)) / 4, rel=1e-3)


@pytest.mark.parametrize("turn", [lambda a: a.T, lambda a: a[:, ::-1], lambda a: a[::-1]])
def test_orientation_makes_no_difference(turn):
    image = oracle.picture(oracle.gaussian(0.5, 7)) * ELECTRONS
    assert iso12233_sfr(turn(image)).sfr50 == pytest.approx(iso12233_sfr(image).sfr50, rel=2e-3)


def test_the_polynomial_follows_a_bowed_edge():
    straight, bowed = (oracle.picture(oracle.curved_gaussian(0.5, bow)) * ELECTRONS for bow in (0.0, 2.0))
    truth = iso12233_sfr(straight).sfr50
    assert iso12233_sfr(bowed).sfr50 == pytest.approx(truth, rel=5e-3)
    assert iso12233_sfr(bowed, order=1).sfr50 < 0.9 * truth


def test_a_colour_of_a_mosaic():
    image = oracle.picture(oracle.gaussian(0.8)) * ELECTRONS
    found = iso12233_sfr(image, cfa="RGGB", channel="G")
    assert found.sfr50 == pytest.approx(oracle.gaussian_half(0.8), rel=0.03)


def test_published_curve_of_sfrmat5(real_data):
    """The published region is 54 px wide; which one is not published."""
    published = np.loadtxt(real_data / "edges" / "v_edge_sfrmat5_published.csv", delimiter=",", skiprows=1)
    picture = read_photograph(real_data / "edges" / "v_edge.tif")
    found = iso12233_sfr(picture, (36, 0, 54, 300), order=1, tone="linear")
    below = published[:, 0] <= 0.5
    assert found.frequency[1] == pytest.approx(published[1, 0], rel=2e-3)
    assert np.max(np.abs(np.interp(published[below, 0], found.frequency, found.sfr) - published[below, 1])) < 0.015
    assert found.sfr50 == pytest.approx(0.203, rel=0.015)


def test_what_is_refused():
    image = oracle.picture(oracle.gaussian(0.5)) * ELECTRONS
    for order in (0, 6, 2.5):
        with pytest.raises(ArgumentError, match="order must be a whole number"):
            iso12233_sfr(image, order=order)
    with pytest.raises(FitError, match="samples too few distances"):
        iso12233_sfr(oracle.picture(oracle.gaussian(0.5, 1e-9)) * ELECTRONS)
    with pytest.raises(FitError, match="one value"):
        iso12233_sfr(np.full((40, 40), 3.0))


def test_numbers_off_an_edge():
    sigma = 0.6
    edge = edge_mtf(oracle.photographs(oracle.gaussian(sigma), 100, 1, 5)[0])
    for level in (0.5, 0.3, 0.2, 0.1):
        truth = np.interp(-level, -oracle.gaussian_mtf(np.linspace(0, 1, 4001), sigma), np.linspace(0, 1, 4001))
        found = level_frequency(edge, level)
        assert abs(found.value - truth) < 3 * found.std < 0.1 * truth
    found = mtf_at(edge, [0.1, 0.4])
    assert np.all(np.abs(found.value - oracle.gaussian_mtf(np.array([0.1, 0.4]), sigma)) < 3 * found.std + 1e-4)
    x = np.linspace(-6, 6, 12001)
    response = oracle.edge(x, np.radians(5), sigma)
    rise = np.interp(0.9, response, x) - np.interp(0.1, response, x)
    found = rise_distance(edge)
    assert abs(found.value - rise) < 3 * found.std < 0.05
    assert iso12233_sfr(oracle.picture(oracle.gaussian(sigma)) * ELECTRONS).rise == pytest.approx(rise, rel=0.06)
    processed = edge_mtf(software.demosaiced(oracle.picture(oracle.gaussian(sigma)) * ELECTRONS))
    assert rise_distance(processed).std / rise_distance(processed).value >= processed.mtf50_std / processed.mtf50
    with pytest.raises(ArgumentError, match="level must lie in"):
        level_frequency(edge, 1.5)
    with pytest.raises(ArgumentError, match="frequency must lie in"):
        mtf_at(edge, 3.0)
