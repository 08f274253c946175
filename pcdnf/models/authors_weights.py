"""Import of the authors' released checkpoint (GitHub ``LabZhengLiu/PCDNF``) into our network's form.

Three things change on the way: the bias before a BatchNorm is merged into its running mean; the matrix of
an EdgeConv on ``[x_j - x_i ; x_i]`` becomes the two of ``pcdnf.models.pcdnf.EdgeConv``, its signs flipped in
channels whose BatchNorm scale is negative, so that the maximum may come before it; layers that the
released code never runs are dropped.
"""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from ..errors import PcdnfError
from .config import NetworkConfig
from .layers import Conv1x1, EdgeConv
from .pcdnf import PCDNF

CONFIG = NetworkConfig(release_transpose=True)
_UNREADABLE = (OSError, EOFError, RuntimeError, pickle.UnpicklingError, LookupError, TypeError, AttributeError)

# Ours -> the release's layer and its BatchNorm.
_EXTRACTORS = {"point_extractor": "pointfeatEX", "normal_extractor": "normalfeatEX"}
_LAYERS = {"small": "conv1_1", "large": "conv1_2", "mix": "conv1_3", "feature": "conv1_5", "lift": "conv1_4"}
_BLOCKS = {
    **{f"{a}.{k}": (f"{b}.{v}.0", f"{b}.{v}.1") for a, b in _EXTRACTORS.items() for k, v in _LAYERS.items()},
    "selector.score": ("weight.conv1.0", "weight.conv1.1"),
    "refinement.point": ("pointFeaFu.conv.0", "pointFeaFu.conv.1"),
    "refinement.normal": ("normalFeaFu.conv.0", "normalFeaFu.conv.1"),
    "decoder.coordinate.conv": ("mlp1.conv.0", "mlp1.conv.1"),
    "decoder.coordinate.reduce.0": ("mlp1.fc1_1", "mlp1.bn1_11"),
    "decoder.coordinate.reduce.1": ("mlp1.fc1_2", "mlp1.bn1_22"),
    "decoder.normal.conv": ("normalDecoder.conv1_1.0", "normalDecoder.conv1_1.1"),
    "decoder.normal.squeeze": ("normalDecoder.conv1_2.0", "normalDecoder.conv1_2.1"),
    "decoder.normal.expand": ("normalDecoder.conv2_1.0", "normalDecoder.conv2_1.1"),
    "decoder.normal.lift": ("normalDecoder.conv2_2.0", "normalDecoder.conv2_2.1"),
    "decoder.normal.reduce.0": ("normalDecoder.fc1_1.0", "normalDecoder.fc1_1.1"),
    "decoder.normal.reduce.1": ("normalDecoder.fc2_1.0", "normalDecoder.fc2_1.1"),
}
_LINEARS = {
    "point_extractor.head.0": "pointfeatEX.fc1.0",
    "point_extractor.head.2": "pointfeatEX.fc1.2",
    "normal_extractor.head.0": "normalfeatEX.fc1.0",
    "normal_extractor.head.2": "normalfeatEX.fc1.2",
    "selector.points": "weight.fc1.0",
    "selector.normals": "weight.fc2.0",
    "selector.angle": "weight.fc3.0",
    "selector.distance": "weight.fc4.0",
    "decoder.coordinate.out": "mlp1.fc1_3",
    "decoder.normal.out": "normalDecoder.fc3_1.0",
}


def convert_release(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Convert the released network's tensors to a state dict of ``PCDNF(CONFIG)``.

    Parameters
    ----------
    tensors : Mapping[str, Tensor]
        ``state_dict`` of the released checkpoint.

    Returns
    -------
    dict[str, Tensor], float32

    Raises
    ------
    PcdnfError
        ``release_tensor_missing`` or ``release_tensor_shape``: these are not the released network's tensors.
    """
    network = PCDNF(CONFIG)
    state: dict[str, Tensor] = {}

    def take(name: str, *shape: int) -> Tensor:
        tensor = tensors.get(name)
        if tensor is None:
            raise PcdnfError(
                f"The checkpoint has no tensor '{name}', so it does not hold the released PCDNF network.",
                code="release_tensor_missing",
                hint="Import a checkpoint that the authors' code wrote.",
            )
        if [size for size in tensor.shape if size > 1] != [size for size in shape if size > 1]:
            raise PcdnfError(
                f"Tensor '{name}' has shape {tuple(tensor.shape)}; the released network has {shape}.",
                code="release_tensor_shape",
                hint="Import a checkpoint that was trained with the settings of the released network.",
            )
        return tensor.detach().float().reshape(shape).clone()  # without the 1 x 1 axes of convolutions

    for name, (layer, norm) in _BLOCKS.items():
        block = network.get_submodule(name)
        assert isinstance(block, EdgeConv | Conv1x1)
        out = block.norm.num_features
        scale, shift = take(f"{norm}.weight", out), take(f"{norm}.bias", out)
        mean, variance = take(f"{norm}.running_mean", out), take(f"{norm}.running_var", out)
        mean -= take(f"{layer}.bias", out)
        if isinstance(block, EdgeConv):
            edge, own = take(f"{layer}.weight", out, 2 * block.centre.in_features).chunk(2, 1)
            sign = torch.where(scale < 0, -1.0, 1.0)
            scale, mean = sign * scale, sign * mean
            state[f"{name}.neighbour.weight"] = sign[:, None] * edge
            state[f"{name}.centre.weight"] = sign[:, None] * (own - edge)
        elif block.shared is None:
            state[f"{name}.linear.weight"] = take(f"{layer}.weight", out, block.linear.in_features)
        else:  # the release concatenates point, patch and normal features
            point, patch, normal = take(f"{layer}.weight", out, 384).chunk(3, 1)
            state[f"{name}.linear.weight"] = torch.cat([point, normal], 1)
            state[f"{name}.shared.weight"] = patch.contiguous()
        state |= {f"{name}.norm.weight": scale, f"{name}.norm.bias": shift}
        state |= {f"{name}.norm.running_mean": mean, f"{name}.norm.running_var": variance}
        state[f"{name}.norm.num_batches_tracked"] = torch.zeros((), dtype=torch.int64)
    for name, layer in _LINEARS.items():
        linear = network.get_submodule(name)
        assert isinstance(linear, nn.Linear)
        state[f"{name}.weight"] = take(f"{layer}.weight", linear.out_features, linear.in_features)
        state[f"{name}.bias"] = take(f"{layer}.bias", linear.out_features)
    return state


def read_release(path: str | Path) -> dict[str, Tensor]:
    """Tensors of a released checkpoint, by the release's names.

    The file is a pickle; ``weights_only=True`` refuses anything in it but tensors and plain containers.

    Raises
    ------
    PcdnfError
        ``release_unreadable``: not a torch checkpoint, or one without a ``state_dict``.
    """
    cause: Exception | None = None
    try:
        with warnings.catch_warnings(action="ignore"):  # torch remarks on pickles it did not write
            tensors = torch.load(path, map_location="cpu", weights_only=True)["state_dict"]
        if all(isinstance(name, str) and isinstance(tensor, Tensor) for name, tensor in tensors.items()):
            return dict(tensors)
    except _UNREADABLE as error:
        cause = error
    raise PcdnfError(
        f"'{Path(path).name}' is not a checkpoint of the released PCDNF code.",
        code="release_unreadable",
        hint="Use a file written by torch.save, with tensors under 'state_dict'.",
    ) from cause
