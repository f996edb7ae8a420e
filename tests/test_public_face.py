"""Arrays and numbers as callers have them: the same values in another form give the same result, and what is no number is
refused or stays missing. Nothing is silently taken for something else.
"""

import datetime
import decimal
import fractions
import functools
import itertools

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
import xarray as xr

import matcam
from matcam import (
    EPD,
    GGX,
    SGD,
    Beckmann,
    BoxPixel,
    Camera,
    Conductor,
    Cylinder,
    DefocusOptics,
    Dielectric,
    DiffractionOptics,
    DistantLamp,
    Flat,
    GaussianNDF,
    GaussianOptics,
    HaloOptics,
    LinearImage,
    MatcamError,
    MeasuredOptics,
    Microfacet,
    NearLamp,
    Rig,
    Schlick,
    SeidelOptics,
    Sensor,
    Sphere,
    WindowedGaussianPixel,
    ZernikeOptics,
)  # fmt: skip
from matcam.camera import PixelNoise
from matcam.core.grid import DIMS, brdf_table, merl_grid
from matcam.files.float_pictures import as_float32
from matcam.files.samples import samples_of

CAMERA = Camera(GaussianOptics(0.5), BoxPixel(0.5))
SENSOR = Sensor(4e-6, 2e4, 2.5, 0.5, 12)
FUNCTIONS = {
    "GGX.d": GGX(0.3).d,
    "GGX.g1": GGX(0.3).g1,
    "Beckmann.d": Beckmann(0.3).d,
    "GaussianNDF.d": GaussianNDF(0.3).d,
    "EPD.d": EPD(0.3, 0.8).d,
    "SGD.d": SGD(0.3, 0.8).d,
    "Microfacet.brdf": lambda x: Microfacet(GGX(0.3), Conductor(0.2, 3.0)).brdf(x, 0.3, 0.5),
    "Microfacet.brdf, theta_d": lambda x: Microfacet(GGX(0.3), Schlick(0.9)).brdf(0.1, x, 0.5),
    "Microfacet.brdf, phi_d": lambda x: Microfacet(GGX(0.3), Dielectric(1.5)).brdf(0.1, 0.3, x),
    "fresnel_conductor": lambda x: matcam.fresnel_conductor(x, 0.2, 3.0),
    "albedo": lambda x: matcam.material.albedo(Microfacet(GGX(0.3), Schlick(0.9)), _row(x)),
    "GaussianOptics.mtf": GaussianOptics(0.5).mtf,
    "GaussianOptics.psf": lambda x: GaussianOptics(0.5).psf(x, 0.25),
    "GaussianOptics.lsf": GaussianOptics(0.5).lsf,
    "HaloOptics.mtf": HaloOptics(GaussianOptics(0.5), 0.01, 9.0).mtf,
    "DiffractionOptics.mtf": DiffractionOptics(8.0, 550e-9, 4e-6).mtf,
    "ZernikeOptics.mtf": ZernikeOptics(8.0, 550e-9, 4e-6, coma=(0.1, 0.0)).mtf,
    "ZernikeOptics.psf": lambda x: ZernikeOptics(8.0, 550e-9, 4e-6, coma=(0.1, 0.0)).psf(x, 0.25),
    "DefocusOptics.mtf": DefocusOptics(8.0, 550e-9, 4e-6, 1.5).mtf,
    "MeasuredOptics.mtf": MeasuredOptics(np.linspace(0, 1, 9), np.linspace(1, 0.2, 9)).mtf,
    "BoxPixel.mtf": BoxPixel(0.4).mtf,
    "BoxPixel.response": BoxPixel(0.4).response,
    "WindowedGaussianPixel.mtf": WindowedGaussianPixel(0.3, 0.5).mtf,
    "Camera.mtf": CAMERA.mtf,
    "Camera.esf": CAMERA.esf,
    "Camera.lsf": CAMERA.lsf,
    "Camera.psf": lambda x: CAMERA.psf(x, 0.5),
    "Sensor.electrons": SENSOR.electrons,
    "Sensor.variance": SENSOR.variance,
    "Sensor.expected_electrons": lambda x: SENSOR.expected_electrons(x, 100.0),
    "Sensor.expose": lambda x: SENSOR.expose(x, 100.0, 1),
    "merge_bracket": lambda x: matcam.camera.merge_bracket(SENSOR, _with_axis(x), [10.0]).radiance,
    "coltman": lambda x: matcam.targets.coltman([0.1, 0.2, 0.4], _row(x)),
    "LinearImage": lambda x: LinearImage(x, "Y").values,
    "peak_response": lambda x: matcam.peak_response(Rig(CAMERA, Sphere(500.0)), GGX(0.01), x),
    "texture_contrast": lambda x: matcam.forward.texture_contrast(Rig(CAMERA, Flat()), x, 0.3),
}  # fmt: skip


def _row(x):
    """The first row, in the form that it has."""
    if isinstance(x, list) and len({len(row) for row in x}) > 1:
        return x
    return x[0] if isinstance(x, list | np.ndarray | xr.DataArray | matcam.core.jax.jax.Array) else x


def _with_axis(x):
    return [x] if isinstance(x, list) else x[None] if isinstance(x, np.ndarray | matcam.core.jax.jax.Array) else x


PLAIN = np.array([[0.125, 0.25, 0.5], [0.0625, 0.75, 1.0]])
"""Values that half precision holds exactly."""


def _strided(x):
    held = np.full((2 * x.shape[0], 3 * x.shape[1]), 7.0)
    held[::2, ::3] = x
    return held[::2, ::3]


def _read_only(x):
    copy = x.copy()
    copy.flags.writeable = False
    return copy


FORMS = {
    "Fortran's order": np.asfortranarray,
    "every other value": _strided,
    "backwards in memory": lambda x: x[::-1, ::-1].copy()[::-1, ::-1],
    "transposed twice": lambda x: x.T.copy().T,
    "float32": lambda x: x.astype(np.float32),
    "float16": lambda x: x.astype(np.float16),
    "long double": lambda x: x.astype(np.longdouble),
    "other byte order": lambda x: x.astype(">f8"),
    "objects": lambda x: x.astype(object),
    "read only": _read_only,
    "unmasked": np.ma.array,
    "JAX": lambda x: matcam.core.jax.jnp.asarray(x),
    "xarray": lambda x: xr.DataArray(x, dims=("row", "column")),
    "list": lambda x: x.tolist(),
}


@functools.cache
def _of_plain(name):
    return np.asarray(FUNCTIONS[name](PLAIN.copy()))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_same_values_in_another_form_give_the_same(name):
    for form, make in FORMS.items():
        given = make(PLAIN)
        try:
            found = np.asarray(FUNCTIONS[name](given))
        except MatcamError:
            assert form in ("xarray", "list", "objects"), form
            continue
        np.testing.assert_allclose(found, _of_plain(name), rtol=1e-12, atol=0, err_msg=form)


NO_NUMBERS = {
    "complex": PLAIN + 1j,
    "text": PLAIN.astype(str).astype(object) + "x",
    "times": PLAIN.astype("timedelta64[s]"),
    "dates": PLAIN.astype("datetime64[s]"),
    "masked": np.ma.masked_less(PLAIN, 0.2),
    "nothing": None,
    "ragged": [[0.5], [0.5, 0.25]],
    "too large": [[10**400] * 3] * 2,
    "fields": np.zeros((2, 3), [("a", float)]),
    "a mapping": {"a": 1.0},
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_no_number_is_refused(name):
    for form, given in NO_NUMBERS.items():
        with pytest.raises(MatcamError) as error:
            FUNCTIONS[name](given)
            pytest.fail(f"{form} was accepted")
        assert "\n" not in str(error.value), form


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_missing_stays_missing_or_is_refused(name):
    """NaN and infinity: never an ordinary number from what is none, and the other values as ever."""
    for bad in (np.nan, np.inf, -np.inf):
        given = PLAIN.copy()
        given[0, 1] = bad
        try:
            found = np.asarray(FUNCTIONS[name](given))
        except MatcamError:
            continue
        _others_are_as_ever(name, found)
        value = found.ravel()[1]
        at_infinity = not np.isnan(bad) and (np.isinf(value) or value == _far_out(name, np.sign(bad)))
        assert np.isnan(value) or at_infinity, (bad, value)


def _others_are_as_ever(name, found):
    assert found.shape == _of_plain(name).shape
    if name == "coltman":  # its interpolant holds all values together
        return
    others = np.arange(found.size) != 1
    np.testing.assert_allclose(found.ravel()[others], _of_plain(name).ravel()[others], rtol=1e-12)


def _far_out(name, sign):
    """The limit towards infinity."""
    given = PLAIN.copy()
    given[0, 1] = sign * 1e300
    return np.asarray(FUNCTIONS[name](given)).ravel()[1]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_extremes_are_right_or_refused(name):
    for extreme in (0.0, -0.0, 5e-324, 1e-300, 1e300, -1e300, np.pi / 2, np.nextafter(np.pi / 2, 0)):
        given = PLAIN.copy()
        given[0, 1] = extreme
        try:
            found = np.asarray(FUNCTIONS[name](given))
        except MatcamError:
            continue
        _others_are_as_ever(name, found)
        if 0 <= extreme <= 1:
            assert np.isfinite(found).all(), extreme


# ---------------------------------------------------------------------------------------------------------- single numbers

MADE = {
    "GGX": (GGX, (0.1,), lambda made: made.d(0.05)),
    "Beckmann": (Beckmann, (0.1,), lambda made: made.d(0.05)),
    "GaussianNDF": (GaussianNDF, (0.1,), lambda made: made.d(0.05)),
    "EPD": (EPD, (0.1, 0.8), lambda made: made.d(0.05)),
    "SGD": (SGD, (0.1, 0.8), lambda made: made.d(0.05)),
    "Conductor": (Conductor, (0.2, 3.0), lambda made: Microfacet(GGX(0.1), made).brdf(0.1, 0.2, 0.3)),
    "Dielectric": (Dielectric, (1.5,), lambda made: Microfacet(GGX(0.1), made).brdf(0.1, 0.2, 0.3)),
    "Schlick": (Schlick, (0.9,), lambda made: Microfacet(GGX(0.1), made).brdf(0.1, 0.2, 0.3)),
    "GaussianOptics": (GaussianOptics, (0.5,), lambda made: made.mtf(0.2)),
    "HaloOptics": (functools.partial(HaloOptics, GaussianOptics(0.5)), (0.01, 9.0), lambda made: made.mtf(0.2)),
    "DiffractionOptics": (DiffractionOptics, (8.0, 550e-9, 4e-6), lambda made: made.mtf(0.2)),
    "DefocusOptics": (DefocusOptics, (8.0, 550e-9, 4e-6, 1.5), None),
    "ZernikeOptics": (ZernikeOptics, (8.0, 550e-9, 4e-6, 0.1), None),
    "SeidelOptics": (SeidelOptics, (8.0, 550e-9, 4e-6, 500.0, 0.01, 0.1, 0.1, 0.05, 0.02), None),
    "BoxPixel": (BoxPixel, (0.5,), lambda made: made.mtf(0.2)),
    "WindowedGaussianPixel": (WindowedGaussianPixel, (0.3, 0.5), lambda made: made.mtf(0.2)),
    "Sensor": (Sensor, (4e-6, 2e4, 2.5, 0.5), lambda made: made.variance(10.0)),
    "Sphere": (Sphere, (500.0, 30.0), None),
    "Cylinder": (Cylinder, (500.0, 30.0), None),
    "DistantLamp": (DistantLamp, (0.01,), None),
    "NearLamp": (NearLamp, (30.0, 0.01), None),
    "PixelNoise": (lambda *given: PixelNoise(*given).check(), (0.01, 1e-4, 0.01), None),
    "Microfacet": (lambda given: Microfacet(GGX(0.1), 0.5, given), (0.1,), lambda made: made.brdf(0.1, 0.2, 0.3)),
    "jitter": (lambda given: Rig(CAMERA, Sphere(500.0), jitter=given), (0.1,), None),
}
"""Name -> (class, numbers that it takes, something that must be a number for all that it takes)."""
ODD = st.one_of(
    st.floats(),
    st.integers(-(10**6), 10**6),
    st.floats(width=32).map(np.float32),
    st.sampled_from([
        10**400, -(10**400), 10**5000, 1e-320, 1e308, True, None, "0.5", b"0.5", 0.5 + 0j, 0.5 + 1j, np.complex64(0.5),
        decimal.Decimal("0.5"), decimal.Decimal("NaN"), fractions.Fraction(1, 2), np.float16(0.5), np.longdouble(0.5),
        np.array(0.5), np.array([0.5]), np.array([0.25, 0.5]), np.array([]), np.ma.masked, np.ma.array([0.5], mask=[True]),
        [0.5], [], {}, {"a": 1}, {0.5}, object(), datetime.timedelta(1), np.timedelta64(1, "s"), np.datetime64("2020-01-01"),
        xr.DataArray(0.5), range(3), float, np.nan, slice(1),
    ]),
)  # fmt: skip


@pytest.mark.parametrize("name", MADE)
@hypothesis.settings(max_examples=25)
@hypothesis.given(data=st.data())
def test_a_number_is_taken_for_what_it_is_or_refused(name, data):
    make, numbers, probe = MADE[name]
    which = data.draw(st.integers(0, len(numbers) - 1))
    odd = data.draw(ODD)
    given = [odd if k == which else number for k, number in enumerate(numbers)]
    try:
        made = make(*given)
        value = np.asarray(0.0 if probe is None else probe(made))
    except MatcamError as error:
        made, message = None, str(error)
    if made is None:
        assert "\n" not in message
        return
    assert np.isfinite(value).all(), given
    assert np.isrealobj(odd) or np.imag(odd) == 0
    if np.ndim(odd) == 0:
        plain = make(*[float(odd) if k == which else number for k, number in enumerate(numbers)])
        assert repr(plain) == repr(made) or plain == made


# ------------------------------------------------------------------------------------------------- pictures and tables

_PICTURE = np.clip(
    64 + 60 * np.tanh((np.add.outer(np.zeros(40), np.arange(40.0)) - 20 + 0.1 * np.arange(40.0)[:, None]) / 2), 1, 125
)
FEW = ("every other value", "other byte order", "backwards in memory")
PICTURES = {
    "edge_mtf": lambda x: matcam.edge_mtf(x).mtf,
    "LinearImage": lambda x: LinearImage.of(x).values,
    "as_float32": as_float32,
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_in_another_form_is_the_same(name):
    noise = np.random.default_rng(1).normal(0, 1, _PICTURE.shape)
    picture = np.round(_PICTURE + noise).astype(np.uint8)
    plain = np.asarray(PICTURES[name](picture.astype(float)))
    for form, make in FORMS.items():
        if form in ("list", "objects", "JAX", "xarray") or (name == "edge_mtf" and form not in FEW):
            continue
        np.testing.assert_array_equal(PICTURES[name](make(picture.astype(float))), plain, err_msg=form)
    for kind in (">u2",) if name == "edge_mtf" else (np.uint16, ">u2", np.int32, np.float32):
        np.testing.assert_array_equal(PICTURES[name](picture.astype(kind)), plain, err_msg=str(kind))
    for form, wrong in {
        "complex": picture + 0j,
        "text": picture.astype(str),
        "line": picture[0],
    }.items():
        with pytest.raises(MatcamError):
            PICTURES[name](wrong)
            pytest.fail(f"{form} was accepted")


@pytest.fixture(scope="module")
def table():
    grid = merl_grid("centre")
    h, d, p = np.meshgrid(grid.theta_h, grid.theta_d, grid.phi_d, indexing="ij", sparse=True)
    values = np.float32(0.25) + np.round(64 * np.cos(h) * np.cos(d) * (2 + np.sin(p))) / 64
    values[80:, 80:] = np.nan
    return brdf_table(np.stack([values, 2 * values, 3 * values], axis=-1), "centre")


def _written(table, folder):
    path = folder / "a.binary"
    matcam.write_merl(path, table, force=True)
    return path.read_bytes()


def _at_positions(table, folder):
    del folder
    return np.asarray(matcam.material.Tabulated(table).brdf(0.2, np.array([0.3, 0.9]), 0.5)).tobytes()


def _as_samples(table, folder):
    del folder
    return samples_of(table).values.astype(float).tobytes()


@pytest.mark.parametrize("use", [_written, _at_positions, _as_samples])
def test_a_table_in_another_form_is_the_same(table, tmp_path, use):
    expected = use(table, tmp_path)
    values = table.values
    for form, same in {
        "Fortran's order": np.asfortranarray(values),
        "float32": values.astype(np.float32),
        "other byte order": values.astype(">f8"),
        "strided": np.repeat(values, 2, axis=1)[:, ::2],
    }.items():
        assert use(table.copy(data=same), tmp_path) == expected, form
    for order in itertools.islice(itertools.permutations(DIMS), 1, None, 5):
        try:
            assert use(table.transpose(*order), tmp_path) == expected, order
        except MatcamError:
            continue
    for form, wrong in {
        "without a coordinate": table.drop_vars("theta_d"),
        "from the other end": table.isel(theta_h=slice(None, None, -1)),
        "rolled": table.roll(phi_d=7, roll_coords=True),
        "without sampling": table.assign_attrs(sampling=None),
        "degrees": table.assign_coords(theta_d=np.degrees(table["theta_d"])),
        "complex": table + 0j,
        "text": table.isel(channel=[0]).astype(str),
        "infinite": table.where(table > 0.3, np.inf),
        "too few": table.isel(theta_h=slice(89)),
        "an array": values,
    }.items():
        with pytest.raises(MatcamError) as error:
            use(wrong, tmp_path)
            pytest.fail(f"{form} was accepted")
        assert "\n" not in str(error.value), form


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda folder: matcam.metal(1, 5e-7), "metal must be a name, got 1"),
        (lambda folder: matcam.metal("Cr", 5e-7, source=1), "source for Cr must be a name"),
        (
            lambda folder: matcam.loss_angle(matcam.rigs.merl(), matcam.GGX(0.1), dims=np.array([1, 2])),
            "dims must be one of",
        ),
        (lambda folder: matcam.loss_angle(matcam.rigs.merl(), matcam.GGX(0.1), dims=True), "dims must be one of"),
        (lambda folder: matcam.io.write_netcdf(folder / "a.nc", 3), "must be an xarray.Dataset, got int"),
        (lambda folder: matcam.io.write_netcdf(folder / "a.nc", xr.DataArray([1.0])), "got DataArray"),
        (lambda folder: matcam.io.write_zarr(folder / "a.zarr.zip", None), "got NoneType"),
        (lambda folder: matcam.io.write_exr(folder / f"{'x' * 253}.exr", np.ones((2, 2))), "File name too long"),
        (
            lambda folder: matcam.io.write_exr(folder / "a.exr", np.ones((2, 2)), force="no"),
            "force must be True or False",
        ),
    ],
)
def test_arguments_of_another_kind_are_an_error_of_the_family(tmp_path, call, words):
    with pytest.raises(matcam.MatcamError, match=words):
        call(tmp_path)
    assert not list(tmp_path.iterdir())
