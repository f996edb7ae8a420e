"""The forward model as a fit needs it: the record of a lobe in the cells around the peak, and its derivatives."""

from __future__ import annotations

import copy
from collections.abc import Iterable

import equinox as eqx
import numpy as np

from matcam._jax import AnyArray, jax, jnp
from matcam.forward.lobe import lobe_record, tangent_offsets
from matcam.inverse.peak_cells import PeakData
from matcam.material.families import ONE_WIDTH
from matcam.material.ndf import MixtureNDF
from matcam.rigs import Rig

_SLICES, _BLOCK = 15, 64  # slices at once, cells in multiples of this: few shapes to compile
_STEP = 1e-4  # relative, of central differences


class LobeModel:
    """Record m of a lobe of one family in the cells of `data`, shape (slices, cells): relative to the lobe's true peak, and
    with the cosines of F D G / (4 cos_i cos_o) relative to the peak's. A function of ln width and of the camera."""

    def __init__(self, data: PeakData, rig: Rig, family: str):
        self.ndf_type = ONE_WIDTH[family]
        self.uncertainty = rig.camera.uncertainty
        self.names = self.uncertainty.names if self.uncertainty else ()
        # the uncertainty is no input of the forward model
        self._camera = eqx.tree_at(lambda c: c.uncertainty, rig.camera, None, is_leaf=lambda x: x is None)
        self._rig = eqx.tree_at(lambda r: r.camera, rig, self._camera)
        # the lobe is the same at phi_d and pi - phi_d: half of the cells need not be computed
        distinct, self._place = np.unique(
            np.stack([data.theta_h, np.round(np.abs(np.cos(data.phi_d)), 12)]), axis=1, return_inverse=True
        )
        distinct = np.pad(distinct, ((0, 0), (0, -distinct.shape[1] % _BLOCK)), mode="edge")
        theta_d = np.pad(data.theta_d, (0, -data.theta_d.size % _SLICES), mode="edge")
        self._blocks = [(distinct[0], block, np.arccos(distinct[1])) for block in theta_d.reshape(-1, _SLICES)]
        self._off_mirror = data.off_mirror

    def ndf(self, log_width: float) -> MixtureNDF:
        """The lobe of that width."""
        return self.ndf_type(np.exp(log_width))

    def record(self, log_width: float) -> np.ndarray:
        """m."""
        return self._in_cells(
            _record(self._rig, self.ndf_type, np.asarray(log_width), *block) for block in self._blocks
        )

    def derivative(self, log_width: float, name: str | None = None) -> np.ndarray:
        """Derivative of m by ln width, or by the camera parameter `name`; central difference, good to 1e-7.

        (Automatic differentiation would be exact, and would compile a second function for longer than all else takes.)
        """
        if name is None:
            return (self.record(log_width + _STEP) - self.record(log_width - _STEP)) / (2 * _STEP)
        value = self._camera.parameters()[name]
        step = _STEP * value
        above, below = (self._moved(name, value + shift).record(log_width) for shift in (step, -step))
        return (above - below) / (2 * float(step))

    def _moved(self, name: str, value: jax.Array) -> LobeModel:
        moved = copy.copy(self)
        moved._rig = eqx.tree_at(lambda r: r.camera, self._rig, self._camera.with_parameters({name: value}))
        return moved

    def _in_cells(self, distinct: Iterable[jax.Array]) -> np.ndarray:
        slices = np.concatenate([np.asarray(block) for block in distinct])
        return self._off_mirror * slices[: len(self._off_mirror), self._place]


@eqx.filter_jit
def _record(
    rig: Rig, ndf_type: type[MixtureNDF], log_width: AnyArray, theta_h: AnyArray, theta_d: AnyArray, phi_d: AnyArray
) -> jax.Array:
    ndf = ndf_type(jnp.exp(log_width))
    x, y = tangent_offsets(rig, ndf, theta_h, theta_d[:, None], phi_d)
    return lobe_record(rig, ndf, theta_d, x, jnp.broadcast_to(y, x.shape)) * ndf.flattening(jnp.asarray(theta_h))
