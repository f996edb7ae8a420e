"""Smith's Lambda by adaptive quadrature of its integral over slopes (docs/model.md 6). Imports nothing of the package."""

import numpy as np
from scipy.integrate import quad


def smith_lambda(p22, theta, width):
    """p22(r): isotropic slope density; width: where it falls off."""
    mu = 1 / np.tan(theta)
    inside = lambda r: r * p22(r) * (np.sqrt(r * r - mu * mu) - mu * np.arccos(min(1.0, mu / r)))  # noqa: E731
    edges = mu + width * np.array([0, 0.3, 1, 3, 10, 30, 100, 1e3, 1e4, 1e6])
    return (
        2
        / mu
        * sum(quad(inside, a, b, epsabs=0, epsrel=1e-12, limit=200)[0] for a, b in zip(edges, edges[1:], strict=False))
    )
