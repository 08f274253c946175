# mypy: disallow-untyped-decorators=False
"""bfloat16 in Numba kernels: conversions as compiler intrinsics, and the array types of the kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import extending, types
from numpy.typing import NDArray

Float = NDArray[np.float32]


Features = NDArray[np.float32] | NDArray[np.uint16]


Index = NDArray[np.int32]


intrinsic: Any = extending.intrinsic


@intrinsic
def widened(typing: Any, value: Any) -> tuple[Any, Callable[..., Any]]:  # noqa: ARG001
    """Convert a feature to float32."""

    def codegen(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if signature.args[0] == types.float32:
            return args[0]
        word = ir.IntType(32)
        return builder.bitcast(builder.shl(builder.zext(args[0], word), ir.Constant(word, 16)), ir.FloatType())

    return types.float32(value), codegen


@intrinsic
def narrowed(typing: Any, value: Any, like: Any) -> tuple[Any, Callable[..., Any]]:  # noqa: ARG001
    """Convert a float32 to an element of the array ``like``, rounded to the nearest even."""

    def codegen(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if signature.return_type == types.float32:
            return args[0]
        word = ir.IntType(32)
        bits = builder.bitcast(args[0], word)
        odd = builder.and_(builder.lshr(bits, ir.Constant(word, 16)), ir.Constant(word, 1))
        bits = builder.add(bits, builder.add(odd, ir.Constant(word, 0x7FFF)))
        return builder.trunc(builder.lshr(bits, ir.Constant(word, 16)), ir.IntType(16))

    return like.dtype(types.float32, like), codegen
