"""What a reader should know of a fit, in plain words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.rigs import Rig

if TYPE_CHECKING:
    from matcam.inverse.material_fit import Prior, Solved


def remarks_on(
    rig: Rig | None, prior: Prior, solved: Solved, determined: bool, at_end: float, half: float, noise_given: bool
) -> tuple[str, ...]:
    """One sentence each. at_end: ln of the width over the narrowest one that a fit tries."""
    said = []
    if rig is None:
        said.append("no rig: fitted as if the camera were perfect")
    elif not prior.axes:
        said.append(
            "the camera is assumed exact" + ("" if rig.camera.uncertainty else ": its profile states no uncertainty")
        )
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
