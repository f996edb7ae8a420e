"""Serialisation of a compiled program, without arbitrary code in its description.

JAX writes the description of a program as a pickle, which may call any function. In this module, the pickle may use only a
short list of classes by which JAX describes arrays. The program itself is machine code, so its file must belong to the user
or to the system (`sealed.py`).
"""

from __future__ import annotations

import enum
import io
import json
from functools import cache
from typing import Any

from jax.experimental import serialize_executable

from matcam.core.jax import jax

_NAMES = {
    "jax": ["P"],
    "jax._src.core": ["ManualAxisType", "MemorySpace", "ShapedArray"],
    "jax._src.interpreters.pxla": ["AllArgsInfo", "UnloadedMeshExecutable"],
    "jax._src.layout": ["AutoLayout", "Format", "Layout"],
    "jax._src.linear_util": ["DebugInfo"],
    "jax._src.mesh": ["AbstractMesh", "AxisType", "Mesh"],
    "jax._src.named_sharding": ["NamedSharding", "UnspecifiedValue", "_unpickle_named_sharding"],
    "jax._src.partition_spec": ["PartitionSpec", "unpickle_pspec"],
    "jax._src.sharding_impls": ["GSPMDSharding", "SingleDeviceSharding", "_unpickle_single_device_sharding"],
    "jax._src.stages": ["ArgInfo"],
    "jaxlib._jax": ["DeviceList", "HloSharding", "OpSharding"],
    "numpy": ["dtype"],
}
"""Names that the description of a program may use: kinds, shapes and positions of arrays, by module. These
objects only contain values. A program of another version of JAX, whose description uses other names, is not cached.
"""


def _member(kind: Any, name: str) -> enum.Enum:
    """Select a member of an Enum by name. A ValueError is raised if `kind` is not an Enum or has no such member."""
    if not (isinstance(kind, enum.EnumMeta) and name in kind.__members__):
        raise ValueError("the description uses an attribute that is not a member of an Enum, which is not allowed")
    return kind[name]


class _Unpickler(serialize_executable._JaxPjrtUnpickler):
    """Unpickler of JAX, restricted to the classes and functions in `_NAMES`."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("builtins", "getattr"):  # by which Python 3.11.0 to 3.11.3 pickles members of an Enum
            return _member
        if name not in _NAMES.get(module, ()):  # before the import, because an import runs code
            raise ValueError(f"the description uses {module[:40]}.{name[:40]}, which is not allowed")
        return super().find_class(module, name)


class _DescriptionUnpickler(_Unpickler):
    """Unpickler of only the description. The machine code is omitted, because loading it takes long."""

    def persistent_load(self, pid: Any) -> Any:
        return None if pid[0] == "exec" else super().persistent_load(pid)


def pack_program(program: Any) -> bytes:
    """Serialise a compiled function of arrays.

    Args:
        program: the compiled function, which returns an array, or a nested tuple of arrays.

    Raises:
        ValueError: the result of the function is not a nested tuple of arrays, or the description of the program uses names
            that are not in `_NAMES`. JAX may raise other errors.
    """
    stored, _, output = serialize_executable.serialize(program)
    positions = jax.tree.unflatten(output, range(output.num_leaves))
    if jax.tree.structure(_as_tuples(json.loads(json.dumps(positions)))) != output:
        raise ValueError("the function must return only arrays, and tuples of arrays")
    client = jax.devices()[0].client
    # names of this version of JAX may be missing in the list
    _DescriptionUnpickler(io.BytesIO(stored), client, client.devices()).load()
    return json.dumps(positions).encode() + b"\n" + stored


def unpack_program(packed: bytes) -> Any:
    """Load a compiled function from the bytes that `pack_program` returned.

    Raises:
        Exception: the bytes are invalid. The errors of the backends of JAX have no other common class.
    """
    if b"lapack_" in packed:  # prefix of the names by which a program calls LAPACK
        _load_lapack()
    head, _, stored = packed.partition(b"\n")
    output = jax.tree.structure(_as_tuples(json.loads(head)))
    client = jax.devices()[0].client
    unloaded, infos, no_kwargs = _Unpickler(io.BytesIO(stored), client, client.devices()).load()
    inputs: Any = jax.tree.structure(((0,) * len(infos), {}))
    return jax.stages.Compiled(unloaded.load(), [], inputs.unflatten(infos), output, no_kwargs=no_kwargs)


@cache
def _load_lapack() -> None:
    """Load LAPACK into JAX by lowering a call of LAPACK. Otherwise a loaded program that calls LAPACK would crash."""
    jax.jit(jax.numpy.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))


def _as_tuples(value: Any) -> Any:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else int(value)
