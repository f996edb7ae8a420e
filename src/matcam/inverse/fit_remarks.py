"""What a reader should know of a fit, in plain words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.rigs import Rig

if TYPE_CHECKING:
    from matcam.inverse.material_fit import Prior, Solved

_UNSEEN = 2.0
"""Standard deviations of its square below which a width may be none at all."""


def remarks_on(
    rig: Rig | None, prior: Prior, solved: Solved, freed: slice, determined: bool, at_end: float, noise_given: bool
) -> tuple[str, ...]:
    """One sentence each. freed: place of the rig's numbers; at_end: ln of the width over the narrowest that a fit tries."""
    said = []
    if rig is None:
        said.append("no rig: fitted as if the camera were perfect")
    elif not prior.axes:
        said.append(
            "the camera is assumed exact" + ("" if rig.camera.uncertainty else ": its profile states no uncertainty")
        )
    stds = np.sqrt(np.diag(solved.covariance)[freed])
    for axis, coordinate, own in zip(prior.axes, solved.p[freed], stds, strict=True):
        square, std = axis.square(coordinate, own)
        if axis.softening and square < _UNSEEN * std:
            said.append(f"{axis.name} is compatible with 0: its square is {square:.2g} +- {std:.2g}")
    if at_end <= 0.05:
        said.append(
            "the lobe is narrower than this camera can tell, or than it could have recorded: the width is a bound; "
            "check that rig and data belong together"
        )
    elif not determined:
        said.append("the roughness is not determined: its standard deviation exceeds 5 %")
    if noise_given and solved.misfit > 1 + 5 * np.sqrt(2 / max(solved.freedom, 1)):
        said.append(f"the data miss the model by {np.sqrt(solved.misfit):.1f} times the stated noise")
    if not noise_given and max(solved.noise.relative, 20 * solved.noise.floor) > 0.05:
        said.append(
            "the data miss the model by more than any pixel's noise: the camera or the family of the lobe is wrong"
        )
    return tuple(said)
