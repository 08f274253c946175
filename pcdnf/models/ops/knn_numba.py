# mypy: disallow-untyped-decorators=False
"""Selection of the k nearest points, as Numba kernels that work on sixteen floats at a time.

For a query's N keys (smaller is nearer) it takes four steps, none of which depends on the data's order:

1. the minimum of each of 32 groups of keys;
2. the k-th smallest of these minima, by a sorting network that runs for sixteen queries at once: at least k keys
   are no larger, and for k = 16 of N = 512 only some six keys too many;
3. the indices of the keys up to that bound, by comparing 64 keys at a time;
4. the rank of each among them, by counting; equal keys rank by index.

The steps stand on a few LLVM vector operations, which LLVM maps to whatever the processor has. They live in this file
because Numba's cache notices changes only in the file of a kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import extending, types
from numba.core import cgutils
from numpy.typing import NDArray

from .bfloat16 import Features, widened

Float = NDArray[np.float32]
Index = NDArray[np.int32]

LANES = 16
GROUPS = 32
MOST = GROUPS
"""Largest k."""
WORD = 64
UNROLLED = 4
"""Hits taken at a time: most words have no more, and the processor need not guess."""

intrinsic: Any = extending.intrinsic
_jit: Any = numba.njit(parallel=True, cache=True, nogil=True)
_inline: Any = numba.njit(cache=True, nogil=True, inline="always")


def _sorting_network(size: int) -> NDArray[np.int64]:
    """Batcher's odd-even merge sort: the pairs to compare, in order."""
    pairs = []
    merged = 1
    while merged < size:
        step = merged
        while step:
            for start in range(step % merged, size - step, 2 * step):
                for i in range(start, min(start + step, size - step)):
                    if i // (2 * merged) == (i + step) // (2 * merged):
                        pairs.append((i, i + step))
            step //= 2
        merged *= 2
    return np.array(pairs, np.int64)


NETWORK = _sorting_network(GROUPS)


def _vector(context: Any, builder: Any, array_type: Any, array: Any, start: Any, lanes: int) -> Any:
    """Pointer to ``lanes`` floats of a one-dimensional array."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [start]), ir.PointerType(ir.VectorType(ir.FloatType(), lanes)))


def _splat(builder: Any, value: Any, lanes: int) -> Any:
    empty = ir.Constant(ir.VectorType(value.type, lanes), ir.Undefined)
    first = builder.insert_element(empty, value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(first, empty, zeros)


@intrinsic
def _mask_up_to(typing: Any, array: Any, start: Any, bound: Any) -> tuple[Any, Callable[..., Any]]:  # noqa: ARG001
    """Bits of the 64 elements from ``start`` on that are no larger than ``bound``."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values = builder.load(_vector(context, builder, signature.args[0], args[0], args[1], WORD), align=4)
        return builder.bitcast(builder.fcmp_ordered("<=", values, _splat(builder, args[2], WORD)), ir.IntType(WORD))

    return types.uint64(array, types.int64, types.float32), codegen


@intrinsic
def _first_bit(typing: Any, bits: Any) -> tuple[Any, Callable[..., Any]]:  # noqa: ARG001
    """Index of the lowest set bit, 64 without one."""

    def codegen(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), codegen


@intrinsic
def _count_bits(typing: Any, bits: Any) -> tuple[Any, Callable[..., Any]]:  # noqa: ARG001
    """Count the set bits."""

    def codegen(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.int64(types.uint64), codegen


@intrinsic
def _group_minima(typing: Any, keys: Any, length: Any, low: Any) -> tuple[Any, Callable[..., Any]]:  # noqa: ARG001
    """Step 1: low[g] becomes the minimum of keys[g], keys[g + 32], ...; length is a multiple of 32."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lanes = ir.VectorType(ir.FloatType(), GROUPS)
        total = cgutils.alloca_once(builder, lanes)  # type: ignore[no-untyped-call]
        builder.store(ir.Constant(lanes, [float("inf")] * GROUPS), total)
        with cgutils.for_range(builder, builder.udiv(args[1], args[1].type(GROUPS))) as loop:
            start = builder.mul(loop.index, args[1].type(GROUPS))
            a = builder.load(_vector(context, builder, signature.args[0], args[0], start, GROUPS), align=4)
            b = builder.load(total)
            builder.store(builder.select(builder.fcmp_ordered("<", a, b), a, b), total)
        target = _vector(context, builder, signature.args[2], args[2], args[1].type(0), GROUPS)
        builder.store(builder.load(total), target, align=4)
        return context.get_dummy_value()

    return types.void(keys, types.int64, low), codegen


@intrinsic
def _order(typing: Any, array: Any, i: Any, j: Any) -> tuple[Any, Callable[..., Any]]:  # noqa: ARG001
    """Put the smaller of each pair into array[i : i + 16], the larger into array[j : j + 16]."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        first = _vector(context, builder, signature.args[0], args[0], args[1], LANES)
        second = _vector(context, builder, signature.args[0], args[0], args[2], LANES)
        a, b = builder.load(first, align=4), builder.load(second, align=4)
        swap = builder.fcmp_ordered("<", b, a)
        builder.store(builder.select(swap, b, a), first, align=4)
        builder.store(builder.select(swap, a, b), second, align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64), codegen


@intrinsic
def _rank(typing: Any, keys: Any, count: Any, ranks: Any) -> tuple[Any, Callable[..., Any]]:  # noqa: ARG001
    """Rank the first ``count`` keys among themselves (int32); both arrays have room for whole lanes."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lanes, word = ir.VectorType(ir.IntType(32), LANES), ir.IntType(32)
        key_data = context.make_array(signature.args[0])(context, builder, args[0]).data
        rank_data = context.make_array(signature.args[2])(context, builder, args[2]).data
        size = args[1].type
        blocks = builder.udiv(builder.add(args[1], size(LANES - 1)), size(LANES))
        total = cgutils.alloca_once(builder, lanes)  # type: ignore[no-untyped-call]
        with cgutils.for_range(builder, blocks) as block:
            start = builder.mul(block.index, size(LANES))
            own = builder.load(_vector(context, builder, signature.args[0], args[0], start, LANES), align=4)
            places = builder.add(
                _splat(builder, builder.trunc(start, word), LANES), ir.Constant(lanes, list(range(LANES)))
            )
            builder.store(ir.Constant(lanes, [0] * LANES), total)
            with cgutils.for_range(builder, args[1]) as other:
                key = _splat(builder, builder.load(builder.gep(key_data, [other.index])), LANES)
                later = builder.icmp_signed(">", places, _splat(builder, builder.trunc(other.index, word), LANES))
                tie = builder.and_(builder.fcmp_ordered("==", key, own), later)
                before = builder.or_(builder.fcmp_ordered("<", key, own), tie)
                builder.store(builder.sub(builder.load(total), builder.sext(before, lanes)), total)
            target = builder.bitcast(builder.gep(rank_data, [start]), ir.PointerType(lanes))
            builder.store(builder.load(total), target, align=4)
        return context.get_dummy_value()

    return types.void(keys, types.int64, ranks), codegen


@_inline
def _take(keys: Any, bound: Any, found: Any, found_keys: Any, ranks: Any, row: Any) -> None:
    """Do steps 3 and 4: the k nearest of keys (P,), nearest first, into row (k,)."""
    k = row.shape[0]
    count = 0
    for start in range(0, keys.shape[0], WORD):
        mask = _mask_up_to(keys, start, bound)
        hits = _count_bits(mask)
        for taken in range(0, hits, UNROLLED):  # writes past the hits are overwritten later
            for t in range(UNROLLED):
                found[count + taken + t] = start + _first_bit(mask)
                mask &= mask - np.uint64(1)
        count += hits
    if count > 4 * LANES:  # many keys equal the bound: the first k of them suffice
        count = 0
        ties = 0
        for j in range(keys.shape[0]):
            if keys[j] < bound or (keys[j] == bound and ties < k):
                ties += keys[j] == bound
                found[count] = j
                count += 1
    for a in range(count):
        found_keys[a] = keys[found[a]]
    _rank(found_keys, count, ranks)
    for a in range(count):
        if ranks[a] < k:
            row[ranks[a]] = found[a]


@_jit
def select_features(gram: Features, squares: Float, queries: Index, index: Index) -> None:
    """Select by inner products: gram (B, N, N), its diagonal (B, N), queries (B, Q) to index (B, Q, k).

    ``gram`` is float32, or bfloat16 seen as uint16. The rank of candidate q for point p is that of ``|q|^2 - 2 p.q``:
    the term ``|p|^2`` is the same for all.
    """
    B, Q, _ = index.shape
    N = gram.shape[1]
    blocks = (Q + LANES - 1) // LANES
    padded = (N + WORD - 1) // WORD * WORD
    for job in numba.prange(B * blocks):
        b, first = job // blocks, job % blocks * LANES
        keys = np.empty((LANES, padded), np.float32)
        keys[:, N:] = np.inf
        low = np.empty(GROUPS, np.float32)
        minima = np.full(GROUPS * LANES, np.inf, np.float32)
        rows = min(LANES, Q - first)
        for lane in range(rows):
            p = queries[b, first + lane]
            products, own = gram[b, p], squares[b]
            row_keys = keys[lane]
            for j in range(N):
                row_keys[j] = own[j] - np.float32(2.0) * widened(products[j])
            row_keys[p] = -np.inf
            _group_minima(row_keys, padded, low)
            for group in range(GROUPS):
                minima[group * LANES + lane] = low[group]
        _finish(keys, minima, queries[b, first : first + rows], index[b, first : first + rows])


@_jit
def select_coordinates(points: Float, queries: Index, index: Index) -> None:
    """Select the k nearest points in space: points (B, N, 3), queries (B, Q) to index (B, Q, k)."""
    B, Q, _ = index.shape
    N = points.shape[1]
    blocks = (Q + LANES - 1) // LANES
    padded = (N + WORD - 1) // WORD * WORD
    axes = np.empty((B, 3, N), np.float32)
    for b in range(B):
        for j in range(N):
            for axis in range(3):
                axes[b, axis, j] = points[b, j, axis]
    for job in numba.prange(B * blocks):
        b, first = job // blocks, job % blocks * LANES
        keys = np.empty((LANES, padded), np.float32)
        keys[:, N:] = np.inf
        xs, ys, zs = axes[b, 0], axes[b, 1], axes[b, 2]
        low = np.empty(GROUPS, np.float32)
        minima = np.full(GROUPS * LANES, np.inf, np.float32)
        rows = min(LANES, Q - first)
        for lane in range(rows):
            p = queries[b, first + lane]
            x, y, z = xs[p], ys[p], zs[p]
            row_keys = keys[lane]
            for j in range(N):
                dx, dy, dz = xs[j] - x, ys[j] - y, zs[j] - z
                row_keys[j] = dx * dx + dy * dy + dz * dz
            row_keys[p] = -np.inf
            _group_minima(row_keys, padded, low)
            for group in range(GROUPS):
                minima[group * LANES + lane] = low[group]
        _finish(keys, minima, queries[b, first : first + rows], index[b, first : first + rows])


@_inline
def _finish(keys: Any, minima: Any, queries: Any, index: Any) -> None:
    """Do steps 2 to 4 for up to sixteen queries: keys (16, P), queries (n,) to index (n, k)."""
    for pair in range(NETWORK.shape[0]):
        _order(minima, NETWORK[pair, 0] * LANES, NETWORK[pair, 1] * LANES)
    k = index.shape[1]
    found = np.empty(keys.shape[1] + LANES, np.int32)
    found_keys = np.empty(keys.shape[1] + LANES, np.float32)
    ranks = np.empty(keys.shape[1] + LANES, np.int32)
    for lane in range(queries.shape[0]):
        index[lane, :] = queries[lane]  # what a key that is not a number leaves
        _take(keys[lane], minima[(k - 1) * LANES + lane], found, found_keys, ranks, index[lane])
