"""Choice of the device and the precision that a network runs with."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from ..errors import PcdnfError


class DeviceError(PcdnfError):
    """The device or precision does not exist on this machine, or the device ran out of memory."""


@contextmanager
def room_for(what: str) -> Iterator[None]:
    """Raise :class:`DeviceError` if the device runs out of memory for ``what``.

    Raises
    ------
    DeviceError
        ``out_of_memory``.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise DeviceError(
            f"The device ran out of memory with {what}.",
            code="out_of_memory",
            hint="Use the lighter model, a smaller part of the cloud, or a device with more memory.",
        ) from error


def choose_device(name: str) -> str:
    """Resolve "auto", "cpu", "cuda" or "cuda:N" to "cpu" or "cuda:N".

    Raises
    ------
    DeviceError
        Unknown name, or no such GPU.
    """
    if name == "auto":
        return "cuda:0" if torch.cuda.is_available() else "cpu"
    if name == "cpu":
        return name
    kind, _, number = name.partition(":")
    if kind != "cuda" or not (number or "0").isdigit():
        raise DeviceError(
            f"There is no device named {name!r}.", code="unknown_device", hint="Use auto, cpu, cuda or cuda:N."
        )
    if int(number or 0) >= torch.cuda.device_count():
        raise DeviceError(
            f"This machine has no device {name}; it has {torch.cuda.device_count()} usable GPUs.",
            code="no_such_device",
            hint="Use device auto or cpu, or install a CUDA build of torch.",
        )
    return f"cuda:{number or 0}"


def has_native_bfloat16(device: str) -> bool:
    """Whether the device multiplies bfloat16 matrices in hardware."""
    if device != "cpu":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())


def choose_precision(name: str, *, device: str) -> str:
    """Resolve "auto", "float32" or "bfloat16" to one of the last two.

    Raises
    ------
    DeviceError
        Unknown name.
    """
    if name == "auto":
        return "bfloat16" if has_native_bfloat16(device) else "float32"
    if name not in ("float32", "bfloat16"):
        raise DeviceError(
            f"There is no precision named {name!r}.",
            code="unknown_precision",
            hint="Use auto, float32 or bfloat16.",
        )
    return name
