"""Application of compiled programs to any number of rows.

The rows are split into arrays of few shapes, because each shape requires a compilation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from matcam.core.jax import jax, jnp

BLOCKS, BLOCK = 64, 1024
"""Default numbers of blocks in a call and of rows in a block. The arrays of a block fit into a cache."""
_SHORTEST, _SHORT, _MEDIUM = 16, 1024, 8192  # lengths at which the spacing of `few_lengths` changes


def in_blocks(function: Callable[..., Any], used: Any, rows: Any) -> Any:
    """Map a function over blocks of rows, and skip unused blocks.

    The entries of unused blocks in the result are 0.

    Args:
        function: function of the rows of one block.
        used: number of blocks to compute; None: all, which reverse differentiation requires.
        rows: arrays, (blocks, rows, ...).
    """
    if used is None:
        return jax.lax.map(jax.checkpoint(function), rows)

    def of(number: Any) -> Any:
        return function(jax.tree.map(lambda a: a[number], rows))

    like = jax.eval_shape(of, 0)
    blocks = jax.tree.leaves(rows)[0].shape[0]
    nothing = jax.tree.map(lambda a: jnp.zeros((blocks, *a.shape), a.dtype), like)
    return jax.lax.fori_loop(
        0, used, lambda number, out: jax.tree.map(lambda a, b: a.at[number].set(b), out, of(number)), nothing
    )


def repeated_sum(function: Callable[..., Any], count: Any, terms: Any, nothing: Any) -> Any:
    """Sum a function over terms, which are the entries of arrays along the first axis.

    Args:
        function: function of one term.
        count: number of terms to sum; None: all, which reverse differentiation requires.
        terms: arrays, (terms, ...).
        nothing: zeros in the shape of the result.
    """
    if count is None:
        return jax.lax.scan(lambda total, term: (total + function(term), None), nothing, terms)[0]
    return jax.lax.fori_loop(
        0, count, lambda number, total: total + function(jax.tree.map(lambda a: a[number], terms)), nothing
    )


def shaped(rows: Any, blocks: int = BLOCKS, block: int = BLOCK) -> tuple[np.ndarray, Any]:
    """Repeat rows to fill arrays of shape (blocks, block).

    Args:
        rows: arrays, (n,), with 1 <= n <= blocks * block.
        blocks: number of blocks. Default: `BLOCKS`.
        block: number of rows of a block. Default: `BLOCK`.

    Returns:
        Number of blocks that the rows fill without repetition, rounded up, and the filled arrays.
    """
    count = jax.tree.leaves(rows)[0].shape[0]
    repeated = jax.tree.map(lambda a: np.resize(a, blocks * block).reshape(blocks, block), rows)
    return np.asarray(-(-count // block)), repeated


def in_calls(program: Callable[..., tuple[Any, ...]], rows: tuple[np.ndarray, ...], *others: Any) -> tuple[Any, ...]:
    """Call a program for any number of rows.

    Args:
        program: function of the number of used blocks, of arrays of rows, (BLOCKS, BLOCK), and of `others`. It returns a
            tuple of arrays, (BLOCKS, BLOCK, ...).
        rows: arrays of equal length, (n,), not empty.
        others: further arguments of the program.

    Returns:
        NumPy arrays, (n, ...).
    """
    size, found = BLOCKS * BLOCK, []
    for begin in range(0, rows[0].shape[0], size):
        part = tuple(a[begin : begin + size] for a in rows)
        out = program(*shaped(part), *others)
        found.append([np.asarray(a).reshape(size, *a.shape[2:])[: part[0].shape[0]] for a in out])
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


def pad_indices(index: np.ndarray) -> np.ndarray:
    """Pad indices to a length of `few_lengths` by repeating the last index."""
    return np.pad(index, (0, few_lengths(index.size) - index.size), mode="edge") if index.size else index


def few_lengths(size: int) -> int:
    """Round a length up to the next of a small number of lengths.

    Each length requires a compilation and a program of 10 to 20 MB. A compilation takes longer than the computation of
    a thousand positions, so up to 1024 each length is four times the previous length. From 1024 to 8192, there are two
    lengths per power of two. Above 8192, there are eight lengths per power of two.
    """
    length = _SHORTEST
    while length < min(size, _SHORT):
        length *= 4
    if size <= length:
        return length
    unit = 2 ** (size - 1).bit_length() // 2 // (2 if size <= _MEDIUM else 8)
    return -(-size // unit) * unit
