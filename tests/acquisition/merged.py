"""Pictures of the oracle's spheres, as a reconstruction reads them."""

import csv

import imagecodecs
import numpy as np

from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.outline import OutlineFit, Sighting
from tests.oracle import ball_outline as oracle

BAYER = np.array([[0.6, 1.0], [1.0, 0.5]])


def merged(values, std, *, clip=np.inf, bayer=False, name="lamp 1", origin=(0, 0)):
    channel = np.zeros(values.shape, int)
    if bayer:
        channel[0::2, 1::2] = channel[1::2, 0::2] = 1
        channel[1::2, 1::2] = 2
    names = ("R", "G", "B") if bayer else ("grey",)
    return MergedPicture(name, np.minimum(values, clip), std, values >= clip, channel, names, origin)


def photograph(radiance, rng, *, sigma=0.5, electrons=3e3, bayer=False, **options):
    values, std = oracle.exposed(oracle.photographed(radiance, sigma), electrons, rng, colours=BAYER if bayer else None)
    return merged(values, std, bayer=bayer, **options)


def around(count, degrees, distance=30.0):
    """Lamps all round the axis."""
    turn = 2 * np.pi * np.arange(count) / count + 0.1
    sin, cos = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    return distance * np.stack([sin * np.cos(turn), sin * np.sin(turn), np.full(count, cos)], axis=1)


def diligent(real_data):
    """The green plane of the 96 pictures, and the published lamps."""
    folder = real_data / "captures" / "diligent_ball"
    with (folder / "lights.csv").open() as file:
        rows = list(csv.DictReader(file))
    lamps = np.array([[float(row[k]) for k in ("lx", "ly", "lz")] for row in rows])
    pictures = []
    for row in rows:
        green = imagecodecs.imread((folder / row["file"]).read_bytes())[..., 1].astype(float)
        std = np.hypot(0.012 * green, 4.0)
        pictures.append(merged(green, std, clip=65535, name=row["file"]))
    return pictures, lamps


def by_powers(picture, start, powers):
    """Outline of a lit sphere with another model of the light inside its limb."""
    return OutlineFit(picture, "lit", Sighting(), powers, np.array(start)).outline()
