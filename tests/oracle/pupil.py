"""The OTF of a lens from its pupil, by brute force: the autocorrelation integral of exp(i phase) in the plane.

Imports nothing of the package.
"""

import numpy as np
from scipy.integrate import dblquad


def defocused_otf(nu, edge_phase):
    """OTF at nu = f / cutoff of a unit circular pupil with phase edge_phase * rho^2, rad."""

    def integrand(y, x):
        return np.cos(edge_phase * ((x + nu) ** 2 + y**2 - (x - nu) ** 2 - y**2))

    def half_chord(x):
        return np.sqrt(max(1 - (abs(x) + nu) ** 2, 0))

    reach = 1 - nu
    area = dblquad(integrand, -reach, 0, lambda x: -half_chord(x), half_chord, epsabs=1e-11, epsrel=1e-11)[0]
    area += dblquad(integrand, 0, reach, lambda x: -half_chord(x), half_chord, epsabs=1e-11, epsrel=1e-11)[0]
    return area / np.pi
