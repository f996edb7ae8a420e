"""JAX in float64. Every module that computes imports `jax` and `jnp` from here, so that the switch is set once.

Float64 is needed: the erf differences of the effective kernel lose all their digits in float32 for broad lobes, and highlights
are 1e3 to 1e6 times brighter than what surrounds them.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from matcam.core.io import user_cache_folder

jax.config.update("jax_enable_x64", True)

__all__ = ["AnyArray", "FloatArray", "is_concrete", "jax", "jnp", "use_compilation_cache"]

AnyArray = jax.Array | np.ndarray
FloatArray = npt.NDArray[np.float64]


def is_concrete(value: object) -> bool:
    """Tell whether `value` holds numbers now, rather than a tracer inside a JAX transformation."""
    return not isinstance(value, jax.core.Tracer)


def use_compilation_cache() -> None:
    """Keep compiled functions in the user's cache folder between runs.

    A program may choose this for its user; a library must not.
    """
    jax.config.update("jax_compilation_cache_dir", str(user_cache_folder() / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
