"""Highlights and the lamps behind them, against rendered spheres, ray geometry, and real photographs."""

import re

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from matcam.acquisition.highlights import find_highlight, find_highlights, lamp_angles_apart, lamp_from_highlight
from matcam.acquisition.mirror_ball import MirrorBall, unit
from matcam.acquisition.outline import stacked
from matcam.core.errors import FitError
from tests.acquisition.merged import by_powers, diligent, merged, photograph
from tests.oracle import ball_outline as oracle

SHAPE = (152, 156)
AT = (75.3, 78.4, 66.0)


def lamp(degrees, azimuth, distance):
    angle, turn = np.radians(degrees), np.radians(azimuth)
    return distance * np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])


def test_pixels_show_the_normals_of_the_oracle():
    ball = oracle.Ball(30.0, 31.0, 25.0, 40.0, (90.0, -50.0))
    points, rays = oracle.rays(ball, (62, 62))
    at = (np.arange(62 * oracle.FINE) + 0.5) / oracle.FINE - 0.5
    mirror = MirrorBall(*ball)
    normals = mirror.normals(*np.meshgrid(at, at, indexing="ij"))
    assert np.array_equal(np.isnan(normals), np.isnan(points))
    assert np.nanmax(np.abs(normals - points)) < 1e-12
    seen = np.isfinite(normals[..., 0])
    assert np.abs(mirror.views(normals[seen]) + rays[seen]).max() < 1e-12
    rows, columns = mirror.position(normals[seen])
    assert np.abs(np.stack([rows, columns]) - at[np.argwhere(seen).T]).max() < 1e-9


def test_a_lamp_is_seen_where_it_is_mirrored():
    """The law of reflection, at the point that a near lamp and a near camera share."""
    rng = np.random.default_rng(0)
    mirror = MirrorBall(30.0, 31.0, 25.0, 12.0, (90.0, -50.0))
    lamps = unit(rng.normal(size=(50, 3)) + np.array([0, 0, 2.0]))
    normals = mirror.mirror_normals(lamps, 7.0)
    light, view = unit(7.0 * lamps - normals), mirror.views(normals)
    assert np.abs(unit(light + view) - normals).max() < 1e-12
    assert np.abs(mirror.lamp_seen_at(normals, 7.0) - lamps).max() < 1e-12


@pytest.mark.parametrize(("alpha", "worst", "bayer"), [(0.02, 0.05, True), (0.1, 0.15, False)])
def test_lamps_are_found_from_highlights(alpha, worst, bayer):
    """Near lamp, near camera; the highlights of the outer lamps are pulled towards the limb."""
    rng = np.random.default_rng(1)
    ball = oracle.Ball(*AT, 40.0)
    mirror = MirrorBall(*ball)
    off = []
    for degrees, azimuth in ((8, 20), (35, 100), (60, 200), (80, 310)):
        at = lamp(degrees, azimuth, 25.0)
        radiance = oracle.lit(ball, SHAPE, at, diffuse=0.2, alpha=alpha)
        picture = photograph(radiance, rng, electrons=3e4 * alpha**2, bayer=bayer)
        found, covariance = lamp_from_highlight(find_highlight(picture, mirror), mirror, 25.0)
        off.append(np.degrees(float(lamp_angles_apart(found, at))))
        assert np.degrees(np.sqrt(np.trace(covariance))) < 1
    assert np.sqrt(np.mean(np.square(off))) < worst


def test_clipped_pixels_are_at_least_so_bright():
    rng = np.random.default_rng(2)
    ball, at = oracle.Ball(*AT), lamp(40, 30, 1e6)
    picture = photograph(oracle.lit(ball, SHAPE, at, diffuse=0.2, alpha=0.05), rng, electrons=1e3)
    clipped = merged(picture.values, picture.std, clip=0.3 * picture.values.max())
    mirror = MirrorBall(*ball)
    found = find_highlight(clipped, mirror)
    assert [remark.code for remark in found.remarks] == ["clipped"]
    row, column = mirror.mirror_position(unit(at))
    assert np.hypot(found.row - row, found.column - column) < 0.1
    with pytest.raises(FitError, match="of the sphere is clipped"):
        find_highlight(merged(picture.values, picture.std, clip=20.0), mirror)


def test_other_bright_spots_are_named():
    rng = np.random.default_rng(3)
    ball = oracle.Ball(*AT)
    mirror = MirrorBall(*ball)
    lamps = [lamp(40, 30, 1e6), lamp(55, 150, 1e6)]
    radiance = sum(
        share * oracle.lit(ball, SHAPE, at, diffuse=0.1, alpha=0.04)
        for share, at in zip((1.0, 0.6), lamps, strict=True)
    )
    found = find_highlight(photograph(radiance, rng, electrons=1e3), mirror)
    assert [remark.code for remark in found.remarks] == ["several-highlights"]
    other = re.search(r"row (\d+), column (\d+)", found.remarks[0].text).groups()
    for position, at, near in (((found.row, found.column), lamps[0], 0.1), (map(int, other), lamps[1], 1.0)):
        assert np.hypot(*np.subtract([*position], mirror.mirror_position(unit(at)))) < near
    matt = photograph(oracle.lit(ball, SHAPE, lamps[0]), rng, name="matt.png")
    dark = merged(rng.normal(0, 3, SHAPE), np.full(SHAPE, 3.0), name="dark.png")
    found, remarks = find_highlights([matt, dark], mirror)
    assert found == [None, None]
    assert [remark.text.split(":")[0] for remark in remarks] == ["matt.png", "dark.png"]


def test_diligent_highlights(real_data):
    """0.4 degrees of the published directions; the radius that they want is beyond the outline's."""
    pictures, lamps = diligent(real_data)
    outline = by_powers(stacked(pictures), (103.7, 103.9, 71.4), (0, 0.5, 1))
    pictures, lamps = pictures[::3], lamps[::3]
    found, _ = find_highlights(pictures, outline.ball)
    assert all(one is not None for one in found)
    assert all("clipped" in {remark.code for remark in one.remarks} for one in found)
    positions = np.array([(one.row, one.column) for one in found])

    def off(p):
        return (np.stack(MirrorBall(*p).mirror_position(lamps), 1) - positions).ravel()

    wanted = least_squares(off, [outline.row, outline.column, outline.radius], loss="soft_l1", x_scale="jac")
    assert np.sqrt(2 * np.mean(off(wanted.x) ** 2)) < 0.25
    assert wanted.x[2] == pytest.approx(72.2, abs=0.2)
    ratio = wanted.x[2] / outline.radius
    assert 1.007 < ratio < 1.016
    # with the outline's radius, the distances that the ratio wants, and the table's axes turned
    larger = outline.ball._replace(radius=outline.radius * ratio)
    seen = larger.lamp_seen_at(larger.normals(*positions.T))
    turn = Rotation.align_vectors(lamps, seen)[0]
    distance = 1 / (ratio - 1)
    near = outline.ball._replace(distance=distance)
    turned = turn.apply(near.lamp_seen_at(near.normals(*positions.T), distance))
    assert np.sqrt(np.mean(np.degrees(lamp_angles_apart(turned, lamps)) ** 2)) < 0.4
