"""The pinhole's table against a binning of its own: pixel by pixel, with rotations in place of scalar products."""

import numpy as np
import pytest

from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.pinhole_table import PinholeTable
from matcam.core.errors import ArgumentError, FitError
from tests.oracle import ball_outline as oracle

SIZE, RADIUS, DISTANCE = 44, 18.0, 30.0
BALL = MirrorBall(21.3, 22.6, RADIUS, DISTANCE)
LAMPS = 20.0 * np.array([[0.5, 0.3, 0.81], [-0.8, 0.2, 0.56], [0.1, -0.7, 0.71]])


def about(axis, angle, vector):
    """Rodrigues."""
    return (
        vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + axis * (axis @ vector) * (1 - np.cos(angle))
    )


def angles(normal, light, view):
    """MERL's own way: turn the half vector's azimuth to 0, then tilt it into the normal."""
    tangent = np.cross(normal, [0.3, 0.5, 0.2])
    tangent /= np.linalg.norm(tangent)
    frame = np.stack([tangent, np.cross(normal, tangent), normal])
    light, view = frame @ light, frame @ view
    half = (light + view) / np.linalg.norm(light + view)
    theta_h, phi_h = np.arccos(half[2]), np.arctan2(half[1], half[0])
    turned = about(np.array([0.0, 1.0, 0.0]), -theta_h, about(np.array([0.0, 0.0, 1.0]), -phi_h, light))
    return theta_h, np.arccos(turned[2]), np.arctan2(turned[1], turned[0])


def brdf(theta_h, theta_d, phi_d):
    return 0.2 + 0.5 * np.exp(-theta_h) + 0.1 * theta_d + 0.1 * theta_h * np.cos(2 * phi_d)


@pytest.fixture(scope="module")
def pictures():
    """Three mosaic pictures, and every pixel's angles and BRDF by the long way."""
    ball = oracle.Ball(BALL.row, BALL.column, RADIUS, DISTANCE)
    points, _ = oracle.rays(ball, (SIZE, SIZE))
    # with an even number of samples a pixel's centre lies between them: nearest ray, found again on the sphere
    middle = (np.arange(SIZE) * oracle.FINE) + oracle.FINE // 2
    out, entries = [], []
    colour = np.add.outer(np.arange(SIZE) % 2, np.arange(SIZE) % 2)
    for lamp in LAMPS:
        values = np.zeros((SIZE, SIZE))
        for row in range(SIZE):
            for column in range(SIZE):
                normal = BALL.normals(row, column)
                near = points[middle[row], middle[column]]
                if np.isnan(normal[0]):
                    continue
                assert np.isnan(near[0]) or np.linalg.norm(near - normal) < 0.25
                light = lamp - normal
                far = np.linalg.norm(light)
                light /= far
                view = np.array([0, 0, DISTANCE]) - normal
                view /= np.linalg.norm(view)
                cos_i = light @ normal
                if cos_i <= 0:
                    continue
                at = angles(normal, light, view)
                gain = 1 + colour[row, column]
                values[row, column] = 3 * gain * brdf(*at) * cos_i * (lamp @ lamp) / far**2
                if min(cos_i, view @ normal) > np.cos(np.radians(87)):
                    entries.append((*at, colour[row, column], gain * brdf(*at)))
        out.append(
            MergedPicture("p", values, np.ones_like(values), values > 1e9, colour, ("R", "G", "B"), origin=(0, 0))
        )
    return out, entries


def test_every_pixel_is_in_its_cell(pictures):
    images, entries = pictures
    table = PinholeTable()
    for image, lamp in zip(images, LAMPS, strict=True):
        distance = np.linalg.norm(lamp)
        table.add(image, BALL, lamp / distance, distance, irradiance=3.0)
    found = table.table()
    cells = {}
    for theta_h, theta_d, phi_d, channel, value in entries:
        i, j = int(90 * np.sqrt(theta_h / (np.pi / 2))), int(theta_d / (np.pi / 2) * 90)
        k = int((phi_d % np.pi) / np.pi * 180)
        for one in {k, 179 - k}:
            cells.setdefault((i, j, one, channel), []).append(value)
    assert table.pixels == len(entries) > 1500
    filled = np.argwhere(np.isfinite(found.values))
    same = sum(tuple(cell) in cells for cell in filled)
    assert same > 0.995 * len(cells)  # but for pixels on a border
    off = [found.values[cell] / np.mean(cells[cell]) - 1 for cell in map(tuple, filled) if cell in cells]
    assert np.mean(np.abs(off) < 1e-9) > 0.995
    assert np.isnan(found.values).mean() > 0.99  # missing stays missing
    assert np.array_equal(found.values, found.values[:, :, ::-1], equal_nan=True)


def test_cropped_and_clipped_pictures(pictures):
    images, _ = pictures
    whole, part = PinholeTable(), PinholeTable()
    whole.add(images[0], BALL, LAMPS[0])
    one = images[0]
    fields = (one.values[3:, 4:], one.std[3:, 4:], one.clipped[3:, 4:], one.channel[3:, 4:])
    part.add(MergedPicture("crop", *fields, one.channels, origin=(3, 4)), BALL, LAMPS[0])
    assert np.array_equal(part.table().values, whole.table().values, equal_nan=True)
    bright = one.values > np.percentile(one.values, 95)
    clipped = PinholeTable()
    clipped.add(MergedPicture("c", one.values, one.std, bright, one.channel, one.channels), BALL, LAMPS[0])
    assert clipped.pixels + clipped.clipped == whole.pixels
    assert clipped.clipped > 50
    with pytest.raises(ArgumentError, match="the colours of the image are"):
        PinholeTable(("grey",)).add(one, BALL, LAMPS[0])
    with pytest.raises(FitError, match="no pixel"):
        PinholeTable().table()
