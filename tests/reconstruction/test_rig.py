"""A rig that an earlier reconstruction found: its document, and the prior that it makes."""

import copy
import json

import numpy as np
import pytest

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.reconstruction.joint.joint_problem import JointLayout
from matcam.reconstruction.picture_model import lamp_frame, turned_lamp
from matcam.reconstruction.rig.earlier_rig import known_rig, rig_covariance
from matcam.reconstruction.rig.rig_document import json_schema, read_rig
from tests.conftest import REPOSITORY

NAMES = ("L0", "L1", "L2")
LAMPS = np.array([[0.0, 0.6, 0.8], [0.8, 0.0, 0.6], [-0.48, 0.6, 0.64]])


def covariance(seed=0):
    root = np.random.default_rng(seed).normal(size=(11, 11)) * np.array([0.03, 1e-4, 2e-4, 1e-3, 0.1, *[1e-3] * 6])
    return root.T @ root


LOBE = {"family": "ggx", "masking": "smith", "spline_modified": False}


def document():
    lamps = [
        {"name": name, "direction": list(at), "std_deg": 0.1, "centre_px": [99.5, 99.5], "gain": 1.0}
        for name, at in zip(NAMES, LAMPS.tolist(), strict=True)
    ]
    names = ["lens", "camera nearness", "lamp nearness", "distortion", "blur growth"]
    names += [f"{name} {turn}" for name in NAMES for turn in "ab"]
    field = {
        "centre_px": [99.5, 99.5],
        "unit_px": 80.0,
        "k1": [0.002, 1e-3],
        "k2": [0.0, 0.0],
        "growth": [0.0, 0.1],
        "holds_at_px": 0,
    }
    return {
        "format": "matcam reconstruction", "version": 1, "verdict": "", "lobe": LOBE,
        "parameters": {"alpha": [0.02, 1e-4]},
        "geometry": {
            "frame_px": [200, 200], "sample_radius_mm": 25.0, "centre_px": [[99.5, 99.5], [0.1, 0.1]], "radius_px": [80.0, 0.1],
            "lamps": lamps, "camera_radii": [40.0, 0.2], "lamp_radii": [25.0, 0.1], "sigma_px": 0.55, "field": field,
            "covariance": {"names": names, "matrix": covariance().tolist()},
        },
        "fresnel": {
            "theta_d_deg": [], "channels": [], "value": [], "std": [], "model": [], "absolute": False, "unit_std": None
        },
        "budget": {}, "unexplained": 0.0, "tried": {}, "pictures": [], "not_determined": [], "radiometry": None, "left_out": [],
        "remarks": [],
    }  # fmt: skip


@pytest.fixture
def written(tmp_path):
    def write(**geometry):
        whole = copy.deepcopy(document())
        whole["geometry"] |= geometry
        path = tmp_path / "rig.json"
        path.write_text(json.dumps(whole))
        return path

    return write


def test_the_published_schema_is_that_of_the_code():
    published = json.loads((REPOSITORY / "docs/reconstruction-v1.schema.json").read_text())
    assert published == json_schema(), "write docs/reconstruction-v1.schema.json anew: rig_document.json_schema()"


def test_a_rig_is_read_back(written):
    rig = read_rig(written())
    assert (rig.frame, rig.sample_radius, rig.sigma, rig.lamps) == ((200, 200), 25.0, 0.55, NAMES)
    assert rig.nearness == (1 / 40, 1 / 25)
    assert rig.field.k1 == (0.002, 1e-3)
    assert rig.covariance == pytest.approx(covariance())
    assert read_rig(written(lamp_radii=[None, None])).nearness[1] == 0


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        (
            {"covariance": {"names": [], "matrix": [[1.0]]}},
            "geometry.covariance: names and matrix must cover 11 parameters",
        ),
        ({"covariance": document()["geometry"]["covariance"] | {"matrix": (-covariance()).tolist()}}, "variances >= 0"),
        ({"lamps": document()["geometry"]["lamps"][:1] * 3}, "two lamps have the same name"),
        ({"radius_px": "80"}, "field geometry.radius_px"),
        ({"other": 1}, "field geometry.other: unknown"),
        ({"field": document()["geometry"]["field"] | {"unit_px": 0}}, "geometry.field: unit_px must lie in"),
    ],
)
def test_documents_that_are_no_rig_are_refused_in_one_line(written, geometry, words):
    with pytest.raises(FileFormatError) as caught:
        read_rig(written(**geometry))
    assert words in str(caught.value)
    assert "rig.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_documents_are_refused(tmp_path):
    path = tmp_path / "profile.json"
    path.write_text('{"format": "matcam camera profile", "version": 3}')
    with pytest.raises(FileFormatError, match='"format" must be "matcam reconstruction"'):
        read_rig(path)


def test_another_rig_is_refused_and_unknown_lamps_are_named(written):
    rig = read_rig(written())
    with pytest.raises(ArgumentError, match="200 x 200 px, but this capture has 300 x 200 px"):
        known_rig(rig, NAMES, (300, 200), 25.0, 0.5)
    with pytest.raises(ArgumentError, match="has none of the lamp positions A, B, but it has L0, L1, L2"):
        known_rig(rig, ("A", "B"), (200, 200), 25.0, 0.5)
    known, remarks = known_rig(rig, ("L2", "X"), None, None, 0.5)
    assert known.lamps.tolist() == [2, -1]
    assert [one.code for one in remarks] == ["rig-lamp-unknown", "rig-radius-not-stated"]


def test_a_smaller_sphere_stands_further_away_in_its_radii(written):
    """12.5 mm for 25 mm: the nearnesses are halved, with their errors; the lens is the earlier fit's over this profile's."""
    known, remarks = known_rig(read_rig(written()), NAMES, (200, 200), 12.5, 0.5)
    assert remarks == ()
    assert known.values[:3] == pytest.approx([np.log(1.1), 1 / 80, 1 / 50])
    assert known.covariance[1, 2] == pytest.approx(covariance()[1, 2] / 4)
    assert known.covariance[1, 5] == pytest.approx(covariance()[1, 5] / 2)
    without, _ = known_rig(read_rig(written()), NAMES, (200, 200), 12.5, None)
    assert without.knows.tolist() == [False, True, True, True, True]


def test_the_prior_holds_values_and_lamps_with_their_covariance(written):
    """At the rig's own values and directions, seen from other base directions, nothing is pulled; its information is the
    covariance's inverse."""
    known, _ = known_rig(read_rig(written()), NAMES, (200, 200), 25.0, 0.5)
    bases = LAMPS + 0.003 * np.random.default_rng(1).normal(size=LAMPS.shape)
    frames = [lamp_frame(one) for one in bases]
    layout = JointLayout(lobe=0, channels=1, pictures=3)
    rows, values = known.prior(layout, frames)
    p = np.zeros(layout.size)
    p[layout.rig] = known.values
    for k, frame in enumerate(frames):
        along = LAMPS[k] @ frame.base
        p[layout.turn(k)] = LAMPS[k] @ frame.first / along, LAMPS[k] @ frame.second / along
        assert np.asarray(turned_lamp(frame, *p[layout.turn(k)])) == pytest.approx(LAMPS[k], abs=1e-12)
    assert rows @ p == pytest.approx(values, abs=0.1)  # the turn of a turn is left out
    used = np.r_[layout.rig, layout.turn(0), layout.turn(1), layout.turn(2)]
    # in frames of the rig's own directions the parameters are the rig's
    own = [lamp_frame(one) for one in LAMPS]
    rows, _ = known.prior(layout, own)
    assert np.linalg.inv(rows[:, used].T @ rows[:, used]) == pytest.approx(covariance(), rel=1e-4, abs=1e-12)


def test_covariance_is_written_in_the_frames_of_the_directions():
    """The turns of lamps count from the directions that were found: a frame turned about the direction turns the covariance."""
    layout = JointLayout(lobe=0, channels=0, pictures=1)
    whole = np.diag([1.0, 9.0, 4.0, 2.0, 5.0, 7.0, 0.0, 0.0, 0.0, 3.0, 8.0, 0.0])
    at = lamp_frame(LAMPS[0])
    swapped = at._replace(first=at.second, second=-at.first)
    found = rig_covariance(whole, layout, [swapped], LAMPS[:1])
    assert np.diag(found) == pytest.approx([1.0, 4.0, 2.0, 5.0, 7.0, 8.0, 3.0])
