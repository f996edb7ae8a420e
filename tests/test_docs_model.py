"""The formulas of docs/model.md, each as the page prints it, by quadrature, and against the public functions."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erf, gamma, gammaincc, gammainccinv, j1, ndtr

import matcam

SIGMA, HALF, RADIUS = 0.45, 0.4, 256.0
CAMERA = matcam.Camera(matcam.GaussianOptics(SIGMA), matcam.BoxPixel(HALF))
RIG = matcam.Rig(CAMERA, matcam.Sphere(RADIUS))


def kernel(x, sigma=SIGMA, half=HALF):
    return (erf((x + half) / (np.sqrt(2) * sigma)) - erf((x - half) / (np.sqrt(2) * sigma))) / (4 * half)


def normal(x, std):
    return np.exp(-((x / std) ** 2) / 2) / (np.sqrt(2 * np.pi) * std)


def a(s, sigma=SIGMA, half=HALF):
    return s / half * np.sqrt(np.pi / 2) * erf(half / (np.sqrt(2) * np.hypot(s, sigma)))


def b(u, s, sigma=SIGMA, half=HALF):
    total = np.sqrt(2) * np.hypot(s, sigma)
    return s / (2 * half) * np.sqrt(np.pi / 2) * (erf((u + half) / total) - erf((u - half) / total))


# 2 Image formation


def test_effective_kernel():
    x = np.linspace(-2, 2, 9)
    by_quadrature = [quad(lambda u, at=at: normal(u, SIGMA) / (2 * HALF), at - HALF, at + HALF)[0] for at in x]
    np.testing.assert_allclose(kernel(x), by_quadrature, rtol=1e-12)
    np.testing.assert_allclose(CAMERA.psf(x, 0.3), kernel(x) * kernel(0.3), rtol=1e-12)
    assert quad(lambda u: u**2 * kernel(u), -9, 9)[0] == pytest.approx(SIGMA**2 + HALF**2 / 3, rel=1e-10)


def test_transfer_function_is_signed():
    f = np.array([0.1, 0.5, 1.0, 1.5])
    printed = np.exp(-2 * (np.pi * SIGMA * f) ** 2) * np.sin(2 * np.pi * HALF * f) / (2 * np.pi * HALF * f)
    by_quadrature = [quad(lambda u, f=f: 2 * kernel(u) * np.cos(2 * np.pi * f * u), 0, 8)[0] for f in f]
    np.testing.assert_allclose(printed, by_quadrature, atol=1e-10)
    np.testing.assert_allclose(CAMERA.mtf(f), printed, atol=1e-15)
    assert printed[-1] < 0  # beyond 1 / (2 p) = 1.25 cycles/px


def test_line_spread_function_at_an_angle():
    angle, x = 0.4, np.linspace(-1.5, 1.5, 7)
    long, short = HALF * np.abs([np.cos(angle), np.sin(angle)])

    def h(x):
        return x * ndtr(x / SIGMA) + SIGMA**2 * normal(x, SIGMA)

    second = h(x + long + short) - h(x + long - short) - h(x - long + short) + h(x - long - short)
    by_quadrature = [quad(lambda u, x=x: kernel(x - u, half=long), -short, short)[0] / (2 * short) for x in x]
    np.testing.assert_allclose(second / (4 * long * short), by_quadrature, rtol=1e-9)
    f = np.array([0.2, 0.7])
    boxes = np.sinc(2 * long * f) * np.sinc(2 * short * f) * np.exp(-2 * (np.pi * SIGMA * f) ** 2)
    np.testing.assert_allclose(CAMERA.mtf(f, angle), boxes, rtol=1e-12)


@pytest.mark.parametrize(("sigma", "percent"), [(0.2, 12), (0.3, 3.4), (0.5, 0.54), (0.8, 0.09)])
def test_a_square_is_not_isotropic(sigma, percent):
    x = np.linspace(0, 4, 401)
    diagonal, aligned = kernel(x / np.sqrt(2), sigma, 0.5) ** 2, kernel(x, sigma, 0.5) * kernel(0.0, sigma, 0.5)
    assert 100 * np.abs(diagonal - aligned).max() / aligned[0] == pytest.approx(percent, rel=0.03)


def test_lenses():
    f, pitch, wavelength, number = np.array([0.1, 0.4, 0.9]), 4e-6, 550e-9, 5.6
    cutoff = pitch / (wavelength * number)
    nu = f / cutoff
    perfect = matcam.DiffractionOptics(number, wavelength, pitch)
    np.testing.assert_allclose(perfect.mtf(f), 2 / np.pi * (np.arccos(nu) - nu * np.sqrt(1 - nu**2)), rtol=1e-12)
    v = np.pi * cutoff * 1.3
    assert perfect.psf(1.3, 0.0) == pytest.approx(np.pi * cutoff**2 / 4 * (2 * j1(v) / v) ** 2, rel=1e-9)
    circle = 3.0
    blurred = [
        4
        / np.pi
        * quad(lambda t, f=f, nu=nu: np.cos(np.pi * circle * f * (t - nu)) * np.sqrt(1 - t**2), nu, 1, epsabs=1e-12)[0]
        for f, nu in zip(f, nu, strict=True)
    ]
    np.testing.assert_allclose(matcam.DefocusOptics(number, wavelength, pitch, circle).mtf(f), blurred, atol=1e-9)
    halo = matcam.HaloOptics(perfect, 0.02, 5.0)
    expected = 0.98 * perfect.mtf(f) + 0.02 * np.exp(-2 * (np.pi * 5 * f) ** 2)
    np.testing.assert_allclose(halo.mtf(f), expected, rtol=1e-12)


def test_area_of_the_papers_kernel_and_its_solid_angle():
    one = quad(lambda u: kernel(u, 0.5, 0.5) ** 2, -8, 8)[0]
    found = matcam.exchange.solid_angles(matcam.rigs.merl())
    assert 1 / one**2 == pytest.approx(4.23, abs=0.005)
    assert found["kernel_area_px2"] == pytest.approx(1 / one**2, rel=1e-3)
    assert found["equivalent_receiver_sr"] == pytest.approx(4 / one**2 / 256**2, rel=1e-3)


def test_variance_of_a_pixel():
    sensor = matcam.Sensor(pitch=5e-6, full_well=2e4, read_noise=3.0, gain=0.5, bits=14)
    assert sensor.variance(1000.0) == pytest.approx(1000 + 9 + 1 / (12 * 0.25), rel=1e-14)


# 1, 3 Angles and samples


def rusinkiewicz(theta_h, theta_d, phi_d):
    """(normal, light, view) with the half vector at the pole and the light at +x."""
    light, view = (np.array([side * np.sin(theta_d), 0, np.cos(theta_d)]) for side in (1, -1))
    normal_azimuth = np.pi - phi_d
    flat = np.sin(theta_h) * np.array([np.cos(normal_azimuth), np.sin(normal_azimuth)])
    return np.array([*flat, np.cos(theta_h)]), light, view


ANGLES = [(0.2, 0.7, 0.4), (0.05, 1.2, 2.5), (0.6, 0.3, 4.0)]


@pytest.mark.parametrize(("theta_h", "theta_d", "phi_d"), ANGLES)
def test_sphere_mapping(theta_h, theta_d, phi_d):
    normal, light, view = rusinkiewicz(theta_h, theta_d, phi_d)
    cos_i = np.cos(theta_h) * np.cos(theta_d) - np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    assert light @ normal == pytest.approx(cos_i, abs=1e-14)
    assert view @ normal == pytest.approx(2 * np.cos(theta_h) * np.cos(theta_d) - cos_i, abs=1e-14)
    psi = np.pi - phi_d
    x = RADIUS * (np.cos(theta_h) * np.sin(theta_d) + np.sin(theta_h) * np.cos(psi) * np.cos(theta_d))
    y = RADIUS * np.sin(theta_h) * np.sin(psi)
    # the picture's axes: across the view, in the plane of the lamp, and across that plane
    right = (light - (light @ view) * view) / np.sin(2 * theta_d)
    assert (x, y) == pytest.approx((RADIUS * right @ normal, RADIUS * np.cross(view, right) @ normal), abs=1e-9)
    position = matcam.Sphere(RADIUS).position(theta_h, theta_d, phi_d)
    assert (position.x, position.y) == pytest.approx((x, y), abs=1e-9)
    assert position.lamp_angle == pytest.approx(2 * theta_d)


def test_sphere_before_a_near_camera():
    d, t = 5.0, 0.9
    x = RADIUS * np.sqrt(d**2 - 1) * np.sin(t) / (d - np.cos(t))
    sphere = matcam.Sphere(RADIUS, d)
    assert sphere.surface(np.array(t), np.array(0.0)).x == pytest.approx(x, rel=1e-13)
    limb = np.arccos(1 / d)
    assert RADIUS * np.sqrt(d**2 - 1) * np.sin(limb) / (d - np.cos(limb)) == pytest.approx(RADIUS, rel=1e-13)
    # cosine of the view, the picture's area per solid angle, the highlight's motion: each from vectors
    camera = np.array([0, 0, d])

    def normal(t, out=0.0):
        return np.array([np.sin(t) * np.cos(out), np.sin(out), np.cos(t) * np.cos(out)])

    def view(n):
        return (camera - n) / np.linalg.norm(camera - n)

    def picture(n):
        return RADIUS * np.sqrt(d**2 - 1) * n[:2] / (d - n[2])

    n = normal(t)
    theta_o = t + np.arctan2(np.sin(t), d - np.cos(t))
    assert view(n) @ n == pytest.approx(np.cos(theta_o), rel=1e-13)
    cos_o = (d * np.cos(t) - 1) / np.sqrt(1 + d**2 - 2 * d * np.cos(t))
    assert np.cos(theta_o) == pytest.approx(cos_o, rel=1e-13)
    step = 1e-5
    along = (picture(normal(t + step)) - picture(normal(t - step))) / (2 * step)
    across = (picture(normal(t, step)) - picture(normal(t, -step))) / (2 * step)
    area = along[0] * across[1] - along[1] * across[0]
    printed = RADIUS**2 * (d**2 - 1) * (d * np.cos(t) - 1) / (d - np.cos(t)) ** 3
    assert area == pytest.approx(printed, rel=1e-8)

    light = 2 * (n @ view(n)) * n - view(n)

    def from_half(n):
        half = light + view(n)
        return np.linalg.norm(n - half / np.linalg.norm(half))

    q = 1 / d
    length = np.sqrt(1 + q**2 - 2 * q * np.cos(t))
    stretch = RADIUS * np.sqrt(1 - q**2)
    in_plane = stretch * (np.cos(t) - q) / (1 - q * np.cos(t)) ** 2
    in_plane /= 1 + q * (np.cos(t) - q) / (2 * length**2)
    out_of_plane = stretch / (1 - q * np.cos(t)) / (1 + q / (2 * length * np.cos(theta_o)))
    step = 1e-4
    moved = [np.linalg.norm(picture(m) - picture(n)) / from_half(m) for m in (normal(t + step), normal(t, step))]
    assert moved == pytest.approx([in_plane, out_of_plane], rel=1e-3)
    found = [float(scale) for scale in sphere.px_per_rad(np.array(theta_o))]
    assert found == pytest.approx([in_plane, out_of_plane], rel=1e-12)


def test_lamp_spread():
    theta_d, radius = 1.1, 1e-3
    rig = matcam.Rig(CAMERA, matcam.Sphere(RADIUS), lamp_radius=radius)
    spread = radius / 4, radius / (4 * np.cos(theta_d))
    assert [float(part) for part in rig.lamp_spread(np.array(theta_d))] == pytest.approx(spread, rel=1e-13)
    # the half vector's motion with the lamp's, per radian: half of it, and over the cosine out of the plane
    _, light, view = rusinkiewicz(0, theta_d, 0)
    for towards, share in (([np.cos(theta_d), 0, -np.sin(theta_d)], 0.5), ([0, 1, 0], 0.5 / np.cos(theta_d))):
        half = light + 1e-6 * np.array(towards) + view
        assert np.linalg.norm(half[:2]) / half[2] / 1e-6 == pytest.approx(share, rel=1e-5)


# 4 The loss at the peak


@pytest.mark.parametrize("width", [2e-4, 2e-3, 2e-2])
def test_loss_of_a_gaussian_lobe(width):
    theta = np.array([0.0, 1.0, 1.4])
    s = width * RADIUS * np.cos(theta)
    by_quadrature = [quad(lambda u, s=s: np.exp(-((u / s) ** 2) / 2) * kernel(u), -8 * s, 8 * s)[0] for s in s]
    np.testing.assert_allclose(a(s), by_quadrature, rtol=1e-9)
    ndf = matcam.GaussianNDF(width)
    np.testing.assert_allclose(matcam.peak_response(RIG, ndf, theta, dims=1), a(s), rtol=1e-10)
    np.testing.assert_allclose(matcam.peak_response(RIG, ndf, theta), a(s) * a(width * RADIUS), rtol=1e-10)


def test_narrow_limit_and_the_printed_equation():
    theta = np.radians(60)
    narrow = 1e-5 * RADIUS
    assert a(narrow * np.cos(theta)) / a(narrow) == pytest.approx(np.cos(theta), rel=1e-4)

    def printed(theta, width, half):
        total = np.hypot(width, SIGMA / (RADIUS * np.cos(theta)))
        return erf(half / RADIUS / (np.sqrt(2) * total))

    for half in (SIGMA, 2.5 * SIGMA):
        found = matcam.paper.peak_eq11(1e-3, SIGMA, half, RADIUS, theta)
        assert found == pytest.approx(printed(theta, 1e-3, half), rel=1e-12)
    angles = np.radians(np.arange(0, 90))
    excess = printed(angles, 1e-9, SIGMA) / printed(0, 1e-9, SIGMA) / np.cos(angles)
    assert 1.16 < excess.max() < 1.17
    at_60 = printed(theta, 1e-9, 2.5 * SIGMA) / printed(0, 1e-9, 2.5 * SIGMA) / np.cos(theta)
    assert at_60 == pytest.approx(1.6, abs=0.01)


def test_record_around_the_peak():
    for u, s in ((0.0, 0.3), (0.8, 0.3), (-2.0, 1.5)):
        expected = quad(lambda t, u=u, s=s: np.exp(-((t / s) ** 2) / 2) * kernel(u - t), -8 * s, 8 * s)[0]
        assert b(u, s) == pytest.approx(expected, rel=1e-9)
    assert b(0.0, 0.7) == pytest.approx(a(0.7), rel=1e-14)
    figure = matcam.paper.figure_3_4(1.0, RIG)  # pixels on whole px, theta_o 0, 45, 60, 75 degrees
    row = figure["recorded"].sel(theta_o=np.radians(60), method="nearest")
    at_two = row.sel(x=2.0, method="nearest")
    assert float(at_two) == pytest.approx(b(2.0, SIGMA * np.cos(np.radians(60))), rel=1e-9)


def test_ggx_is_a_mixture_of_gaussians():
    for r in (0.0, 0.5, 3.0):
        mixture = quad(lambda t, r=r: t * np.exp(-t * (1 + r**2)), 0, np.inf)[0]
        assert mixture == pytest.approx((1 + r**2) ** -2, rel=1e-9)
    alpha, theta = 0.003, np.array([0.3, 1.3])

    def integrand(log_t, cosine):
        t = np.exp(log_t)
        std = alpha * RADIUS / np.sqrt(2 * t)
        return t**2 * np.exp(-t) * a(std * cosine) * a(std)

    expected = [quad(integrand, -20, 5, args=(np.cos(t),), epsabs=1e-13)[0] for t in theta]
    np.testing.assert_allclose(matcam.peak_response(RIG, matcam.GGX(alpha), theta), expected, rtol=1e-8)


def test_sgd_is_a_mixture_of_gaussians():
    power, x = 0.8, 0.7
    # v = (u - 1)^p takes the singularity at u = 1 away
    mixture = quad(lambda v: np.exp(-x * (1 + v ** (1 / power))) / power, 0, np.inf)[0] / gamma(power)
    assert mixture == pytest.approx(x**-power * np.exp(-x), rel=1e-9)


# 6 Microfacet pieces


def test_normal_distributions_as_printed():
    theta = np.array([0.0, 0.1, 0.6])
    tan2, cos = np.tan(theta) ** 2, np.cos(theta)
    alpha, p = 0.2, 0.7
    np.testing.assert_allclose(
        matcam.Beckmann(alpha).d(theta), np.exp(-tan2 / alpha**2) / (np.pi * alpha**2 * cos**4), rtol=1e-12
    )
    np.testing.assert_allclose(
        matcam.GGX(alpha).d(theta), alpha**2 / (np.pi * (cos**2 * (alpha**2 - 1) + 1) ** 2), rtol=1e-12
    )
    printed = p / (np.pi * alpha**2 * gamma(1 / p) * cos**4) * np.exp(-((tan2 / alpha**2) ** p))
    np.testing.assert_allclose(matcam.EPD(alpha, p).d(theta), printed, rtol=1e-11)
    x = alpha + tan2 / alpha
    k = 1 / (alpha * gamma(1 - p) * gammaincc(1 - p, alpha))
    np.testing.assert_allclose(matcam.SGD(alpha, p).d(theta), k * np.exp(-x) / (np.pi * x**p * cos**4), rtol=1e-9)
    share = 0.3
    steepest = np.sqrt(alpha**2 * gammainccinv(1 / p, share) ** (1 / p))

    def density(r):
        return 2 * np.pi * r * p / (np.pi * alpha**2 * gamma(1 / p)) * np.exp(-((r**2 / alpha**2) ** p))

    assert quad(density, steepest, 20)[0] == pytest.approx(share, rel=1e-7)


def smith_lambda(slope_density, theta):
    mu = 1 / np.tan(theta)

    def integrand(y):  # r^2 = mu^2 + y^2
        r = np.hypot(mu, y)
        return y * slope_density(r) * (y - mu * np.arccos(mu / r))

    return 2 / mu * quad(integrand, 0, np.inf, epsabs=1e-13, limit=200)[0]


def test_smith_masking_of_any_slopes():
    theta, alpha, p = 1.3, 0.4, 0.7

    def ggx(r):
        return alpha**2 / (np.pi * (alpha**2 + r**2) ** 2)

    def beckmann(r):
        return np.exp(-((r / alpha) ** 2)) / (np.pi * alpha**2)

    def epd(r):
        return p / (np.pi * alpha**2 * gamma(1 / p)) * np.exp(-((r / alpha) ** (2 * p)))

    nu = 1 / (alpha * np.tan(theta))
    closed = {
        ggx: (np.sqrt(1 + (alpha * np.tan(theta)) ** 2) - 1) / 2,
        beckmann: (np.exp(-(nu**2)) / (nu * np.sqrt(np.pi)) - 1 + erf(nu)) / 2,
    }
    for density, expected in closed.items():
        assert smith_lambda(density, theta) == pytest.approx(expected, rel=1e-8)
    for density, ndf in ((ggx, matcam.GGX(alpha)), (beckmann, matcam.Beckmann(alpha)), (epd, matcam.EPD(alpha, p))):
        assert ndf.g1(theta) == pytest.approx(1 / (1 + smith_lambda(density, theta)), rel=1e-8)


@pytest.mark.parametrize("masking", ["smith", "smith-separable", "van-ginneken", None])
def test_microfacet_brdf(masking):
    theta_h, theta_d, phi_d = ANGLES[1]
    ndf, f = matcam.GGX(0.3), 0.8
    normal, light, view = rusinkiewicz(theta_h, theta_d, phi_d)
    cos_i, cos_o = light @ normal, view @ normal
    one, other = (1 / float(ndf.g1(np.arccos(c))) - 1 for c in (cos_i, cos_o))
    across_i, across_o = light - cos_i * normal, view - cos_o * normal
    phi = np.arccos(across_i @ across_o / np.linalg.norm(across_i) / np.linalg.norm(across_o))
    share = 4.41 * phi / (4.41 * phi + 1)
    g = {
        "smith": 1 / (1 + one + other),
        "smith-separable": 1 / (1 + one) / (1 + other),
        "van-ginneken": 1 / (1 + max(one, other) + share * min(one, other)),
        None: 1.0,
    }[masking]
    found = matcam.Microfacet(ndf, f, diffuse=0.2, masking=masking).brdf(theta_h, theta_d, phi_d)
    assert float(found) == pytest.approx(f * float(ndf.d(theta_h)) * g / (4 * cos_i * cos_o) + 0.2 / np.pi, rel=1e-9)


def test_fresnel_term_of_a_conductor():
    theta, m = 1.2, 3.2 + 3.3j
    g = np.sqrt(m**2 - np.sin(theta) ** 2)
    s = abs((np.cos(theta) - g) / (np.cos(theta) + g)) ** 2
    p = abs((m**2 * np.cos(theta) - g) / (m**2 * np.cos(theta) + g)) ** 2
    assert matcam.fresnel_conductor(theta, m.real, m.imag) == pytest.approx((s + p) / 2, rel=1e-13)


# 7, 8 Calibration and inverse


def test_coltmans_series_is_the_inverse_of_a_square_wave():
    def mtf(f):
        return np.exp(-2 * (np.pi * 0.5 * f) ** 2)

    def contrast(f):  # of a square wave, at the middle of its lines
        k = np.arange(1, 61, 2)
        return 4 / np.pi * np.sum((-1.0) ** (k // 2) / k * mtf(np.multiply.outer(f, k)), axis=-1)

    f = 0.21
    series = np.pi / 4 * (contrast(f) + contrast(3 * f) / 3 - contrast(5 * f) / 5 + contrast(7 * f) / 7)
    assert series == pytest.approx(mtf(f), rel=1e-9)
    dense = np.arange(1, 150) * 0.014
    assert matcam.targets.coltman(dense, contrast(dense))[14] == pytest.approx(mtf(dense[14]), abs=2e-3)


def test_inverse_root_with_a_picture_gain():
    rng = np.random.default_rng(1)
    model, variance, gain = rng.uniform(1, 3, 6), rng.uniform(0.1, 1, 6), 0.3
    direction = model / np.sqrt(variance)
    size2 = direction @ direction
    shorten = np.eye(6) - (1 - 1 / np.sqrt(1 + gain**2 * size2)) * np.outer(direction, direction) / size2
    root = shorten / np.sqrt(variance)
    covariance = np.diag(variance) + gain**2 * np.outer(model, model)
    np.testing.assert_allclose(root @ covariance @ root.T, np.eye(6), atol=1e-12)


def test_record_in_polar_coordinates():
    """Section 3's integral over normals and section 8's over (theta, psi) are one, for a GGX lobe without masking."""
    theta_d, alpha, x0 = 0.6, 0.02, RADIUS * np.sin(0.6)
    nodes, weights = np.polynomial.legendre.leggauss(120)
    theta, psi = 0.02 * (nodes + 1) / 2, np.pi * (nodes + 1)
    at_x = np.cos(theta)[:, None] * np.sin(theta_d) + np.outer(np.sin(theta), np.cos(psi)) * np.cos(theta_d)
    at_y = np.outer(np.sin(theta), np.sin(psi))
    w = (kernel(x0 - RADIUS * at_x) * kernel(RADIUS * at_y)) @ (np.pi * weights)
    d = alpha**2 / (np.pi * (np.cos(theta) ** 2 * (alpha**2 - 1) + 1) ** 2)
    record = RADIUS**2 / 4 * np.sum(0.01 * weights * d * w * np.sin(theta))
    # the same over the sensor: d omega = dx dy / (r^2 cos theta_o)
    u = 4 * nodes
    x, y = np.meshgrid((x0 + u) / RADIUS, u / RADIUS, indexing="ij")
    z = np.sqrt(1 - x**2 - y**2)
    cos2 = (x * np.sin(theta_d) + z * np.cos(theta_d)) ** 2
    light = alpha**2 / (np.pi * (cos2 * (alpha**2 - 1) + 1) ** 2) / 4 / z
    over_sensor = 16 * (weights * kernel(u)) @ light @ (weights * kernel(u))
    assert record == pytest.approx(over_sensor, rel=1e-6)


# 10 From photographs


def test_projection_is_section_3s():
    distance, focal, t = 6.0, 1500.0, 0.7
    outline = focal / np.sqrt(distance**2 - 1)
    x = focal * np.sin(t) / (distance - np.cos(t))
    assert matcam.Sphere(outline, distance).surface(np.array(t), np.array(0.0)).x == pytest.approx(x, rel=1e-13)


@pytest.mark.parametrize(("alpha", "error"), [(0.02, 0.021), (0.1, 0.56), (0.2, 2.39)])
def test_brightest_pixel_is_nearer_to_the_limb(alpha, error):
    theta_d, normal = np.radians(75), np.radians(np.linspace(74, 80, 600001))
    cos_i, cos_o, cos_h = np.cos(2 * theta_d - normal), np.cos(normal), np.cos(normal - theta_d)
    one, other = ((np.sqrt(1 + alpha**2 * (c**-2 - 1)) - 1) / 2 for c in (cos_i, cos_o))
    radiance = alpha**2 / (cos_h**2 * (alpha**2 - 1) + 1) ** 2 / (1 + one + other) / cos_o
    assert np.degrees(normal[radiance.argmax()] - theta_d) == pytest.approx(error, rel=0.03)


def test_fresnel_terms_at_75_degrees_depend_on_the_angle():
    theta = np.radians([74.9, 75.1])
    dielectric = np.asarray(matcam.fresnel_conductor(theta, 1.5, 0.0))
    assert np.log(dielectric[1] / dielectric[0]) / 0.2 == pytest.approx(0.082, abs=0.0005)
