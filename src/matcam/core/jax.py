"""JAX in float64. All numerical modules import `jax` and `jnp` from this module, which sets the option for float64.

Float64 is required for two reasons. The erf differences of the effective kernel lose all digits in float32 for broad
lobes. Highlights are 1e3 to 1e6 times brighter than their surroundings.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from matcam.core.arrays.namespace import FloatArray, is_concrete, jax_is_there
from matcam.core.errors import ArgumentError
from matcam.core.io import user_cache_folder
from matcam.core.sealed import CompiledFunctions, remove_sealed, sealed_files

jax.config.update("jax_enable_x64", True)
jax_is_there(jax)

__all__ = [
    "AnyArray",
    "Device",
    "FloatArray",
    "Runs",
    "computes_on_gpu",
    "has_gpu",
    "is_concrete",
    "jax",
    "jit_plainly",
    "jnp",
    "placed",
    "plainly_compiled",
    "program_folder",
    "transferred",
    "use_compilation_cache",
    "use_device",
    "without_derivatives",
]

AnyArray = jax.Array | np.ndarray

P = ParamSpec("P")
T = TypeVar("T")
Runs = Literal["once", "some", "many", "mostly"]
Device = Literal["cpu", "gpu"]


_LARGEST_CACHE = 1 << 30  # total size of the cached functions above which the oldest are removed, bytes
_SEALED = "compiled"


def has_gpu() -> bool:
    """Check whether JAX could compute on a GPU of this machine.

    JAX does not start the GPU for this check, because the start takes seconds and memory.
    """
    # these modules add GPU support to JAX
    known = any(
        importlib.util.find_spec(plugin)
        for plugin in ("jax_cuda12_plugin", "jax_cuda13_plugin", "jax_rocm60_plugin", "jax_rocm7_plugin")
    )
    # NVIDIA and AMD on Linux, and the Windows subsystem for Linux
    return known and any(Path(device).exists() for device in ("/dev/nvidia0", "/dev/kfd", "/dev/dxg"))


def computes_on_gpu() -> bool:
    """Check whether JAX computes on a GPU. This starts the backend of JAX."""
    return bool(jax.default_backend() != "cpu")


def use_device(device: Device) -> None:
    """Select the processor or a GPU for JAX.

    This function must be called before the first computation of JAX.

    Args:
        device: "cpu" or "gpu".

    Raises:
        ArgumentError: there is no GPU that JAX can use.
    """
    if device == "gpu" and not has_gpu():
        raise ArgumentError(
            f"device must be 'cpu', got {device!r}: JAX finds no GPU here; for an NVIDIA GPU, run "
            "python -m pip install 'matcam[gpu]'"
        )
    jax.config.update("jax_platforms", "cpu" if device == "cpu" else None)


def without_derivatives(tree: T) -> T:
    """Replace each JAX array in a pytree by a constant with the value of the array.

    The constants have no derivatives. They are concrete under `jax.grad`, but not under `jax.jit`.
    """
    return jax.tree.map(lambda leaf: jax.lax.stop_gradient(leaf) if isinstance(leaf, jax.Array) else leaf, tree)


def placed(array: npt.ArrayLike) -> jax.Array:
    """Convert numbers to an array of JAX without compilation.

    In contrast, `jnp.asarray` compiles a program for every shape. The numbers must not be changed afterwards, because
    JAX may use them in place.
    """
    with jax.ensure_compile_time_eval():  # concrete inside a transformation, too
        return jax.device_put(np.asarray(array))


def transferred(tree: T) -> T:
    return jax.tree.map(lambda leaf: placed(leaf) if isinstance(leaf, np.ndarray) else leaf, tree)


def plainly_compiled(runs: Runs = "some") -> dict[str, Any] | None:
    """Select options for `jax.jit` that reduce the compile time. The result is None for the default options.

    `runs` is the expected number of runs. The following times are relative to the default options:

        "once"      a quarter of the compile time, and twice the run time
        "some"      two thirds of the compile time; most programs are not slower
        "many"      three quarters of the compile time; few programs are slower
        "mostly"    the default options, for a program that takes most of the time of a command

    With the default options, elementary functions in loops take half the time that they take with the other options.
    """
    if runs == "mostly":
        return None
    options: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False}
    if runs == "once" or jax.config.read("jax_disable_most_optimizations"):
        options["xla_backend_optimization_level"] = 0
    elif runs == "some":
        options["xla_backend_optimization_level"] = 1
    return {name: value for name, value in options.items() if _is_known(name, value)} or None


def jit_plainly(function: Callable[P, T], *, runs: Runs = "some", static: tuple[str, ...] = ()) -> Callable[P, T]:
    """Compile a function as `jax.jit` does, with the options of `plainly_compiled`.

    The result must not be called inside another compiled function, because the options apply to an entire program. `runs`
    is the expected number of runs, as in `plainly_compiled`. `static` contains the names of arguments that are not arrays.
    """
    programs: dict[bool, Callable[P, T]] = {}

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        bare = jax.config.read("jax_disable_most_optimizations")
        if bare not in programs:  # the options require the backend, which an import must not start
            options = plainly_compiled(runs)
            programs[bare] = jax.jit(function, static_argnames=static, compiler_options=options)
        return programs[bare](*args, **kwargs)

    return call


@cache
def _is_known(option: str, value: Any) -> bool:
    try:
        jax.jit(lambda x: x, compiler_options={option: value}).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def use_compilation_cache() -> None:
    """Keep compiled functions for later runs in the user's cache folder.

    An application may call this function; a library must not, because it changes a setting of JAX. Each shape of an image
    requires separate compiled functions. Therefore the least recently used files are removed above a total size of 1 GiB.
    """
    folder = user_cache_folder() / (_SEALED if _use_sealed_cache() else "jax")
    _trim(folder)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def program_folder() -> Path | None:
    """Return the folder of cached programs, or None if there is no sealed cache (`sealed.py`).

    The sealed cache requires a call of `use_compilation_cache`, and a version of JAX that supports it.
    """
    folder = getattr(jax.config, "jax_compilation_cache_dir", None)
    return Path(folder) if folder and Path(folder).name == _SEALED else None


def _use_sealed_cache() -> bool:
    """Replace the cache of JAX by a sealed cache. The result is False if this version of JAX does not support that."""
    try:
        from jax._src import compilation_cache
    except ImportError:
        return False
    there = hasattr(compilation_cache, "get_file_cache")
    if there:
        sealed: Any = lambda path: (CompiledFunctions(path), path)  # noqa: E731
        compilation_cache.get_file_cache = sealed
    return there


def _trim(folder: Path) -> None:
    # the limit of JAX is not used: it fails permanently if a process was killed between two of its writes
    files = sorted((max(of.st_atime, of.st_mtime), of.st_size, name) for name, of in sealed_files(folder).items())
    total, unused = sum(size for _, size, _ in files), []
    for _, size, name in files:
        if total > _LARGEST_CACHE or not size:
            unused.append(name)
            total -= size
    remove_sealed(folder, unused)
