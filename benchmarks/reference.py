"""The same network written the plain way, edges and all, under the released checkpoint's names.

An independent witness for the tests (it loads a released checkpoint as it is) and the baseline of ``throughput.py``:
every EdgeConv gathers its (B, 2 C, M, k) edges, convolves them and takes the maximum; neighbours come from a full
distance matrix and ``torch.topk``.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def nearest(x: Tensor, k: int) -> Tensor:
    """x (B, C, M) -> indices (B, M, k) of the nearest points, each point among its own."""
    inner = 2 * torch.bmm(x.transpose(1, 2), x)
    square = (x**2).sum(1, keepdim=True)
    return (inner - square - square.transpose(1, 2)).topk(k, dim=-1).indices


def neighbours(x: Tensor, index: Tensor) -> Tensor:
    """x (B, C, M), index (B, Q, k) -> (B, C, Q, k)."""
    B, C, _ = x.shape
    flat = index.reshape(B, 1, -1).expand(B, C, -1)
    return x.gather(2, flat).view(B, C, *index.shape[1:])


def edges(x: Tensor, k: int) -> Tensor:
    """x (B, C, M) -> concat(x_j - x_i, x_i), (B, 2 C, M, k); after DGCNN's ``get_graph_feature``."""
    B, C, M = x.shape
    index = nearest(x, k) + torch.arange(B, device=x.device)[:, None, None] * M
    rows = x.transpose(1, 2).reshape(B * M, C)
    near = rows[index.flatten()].view(B, M, k, C)
    own = rows.view(B, M, 1, C).expand(-1, -1, k, -1)
    return torch.cat([near - own, own], -1).permute(0, 3, 1, 2).contiguous()


def conv1(channels: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv1d(channels, out, 1), nn.BatchNorm1d(out), nn.LeakyReLU(0.2))


def conv2(channels: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(channels, out, 1), nn.BatchNorm2d(out), nn.LeakyReLU(0.2))


def dense(channels: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(channels, out), nn.BatchNorm1d(out), nn.LeakyReLU(0.2))


class Extractor(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.conv1_1, self.conv1_2 = conv2(6, 16), conv2(6, 32)
        self.conv1_3, self.conv1_5, self.conv1_4 = conv1(48, 64), conv2(128, 64), conv1(64, 128)
        self.fc1 = nn.Sequential(nn.Linear(128, 64), nn.ReLU(), nn.Linear(64, 3))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        small, large = self.conv1_1(edges(x, 8)).amax(-1), self.conv1_2(edges(x, 16)).amax(-1)
        f = self.conv1_3(torch.cat([small, large], 1))
        f = self.conv1_4(self.conv1_5(edges(f, 16)).amax(-1))  # (B, 128, M)
        return f, x + self.fc1(f.transpose(1, 2)).transpose(1, 2)


class Selector(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.fc1, self.fc2 = (nn.Sequential(nn.Linear(128, 64), nn.ReLU()) for _ in range(2))
        self.fc3, self.fc4 = (nn.Sequential(nn.Linear(1, 32), nn.ReLU()) for _ in range(2))
        self.conv1 = conv1(192, 128)

    def forward(self, p: Tensor, n: Tensor, f_p: Tensor, f_n: Tensor) -> Tensor:
        p, n = p.transpose(1, 2), n.transpose(1, 2)  # (B, M, 3)
        across = torch.linalg.cross(p, n, dim=-1).norm(dim=-1, keepdim=True)
        angle = torch.atan2(across, (p * n).sum(-1, keepdim=True))
        distance = torch.exp(-(p**2).sum(-1, keepdim=True))
        parts = [self.fc1(f_p.transpose(1, 2)), self.fc2(f_n.transpose(1, 2)), self.fc3(angle), self.fc4(distance)]
        return torch.sigmoid(self.conv1(torch.cat(parts, -1).transpose(1, 2)).amax(1))  # (B, M)


class Augmentation(nn.Module):
    def __init__(self, transpose: bool) -> None:
        super().__init__()
        self.conv = conv1(128, 128)
        self.transpose = transpose

    def forward(self, f: Tensor, weight: Tensor, selected: Tensor, index: Tensor) -> Tensor:
        near = f * weight[:, None]  # (B, 128, M)
        if self.transpose:
            near = near.contiguous().view(len(f), f.shape[2], f.shape[1]).transpose(1, 2)
        return self.conv(neighbours(f, selected[..., None])[..., 0] + neighbours(near, index).mean(-1))


class CoordinateRegressor(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.conv = conv1(384, 512)
        self.fc1_1, self.bn1_11 = nn.Linear(512, 256), nn.BatchNorm1d(256)
        self.fc1_2, self.bn1_22 = nn.Linear(256, 64), nn.BatchNorm1d(64)
        self.fc1_3 = nn.Linear(64, 3)

    def forward(self, f: Tensor) -> Tensor:
        f = F.relu(self.bn1_11(self.fc1_1(self.conv(f).amax(-1))))
        return torch.tanh(self.fc1_3(F.relu(self.bn1_22(self.fc1_2(f)))))


class NormalRegressor(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.conv1_1, self.conv1_2 = conv1(256, 128), conv2(256, 64)
        self.conv2_1, self.conv2_2 = conv2(128, 128), conv1(128, 256)
        self.fc1_1, self.fc2_1 = dense(256, 128), dense(128, 64)
        self.fc3_1 = nn.Sequential(nn.Linear(64, 3))

    def forward(self, f: Tensor) -> Tensor:
        f = self.conv1_1(f)
        g = self.conv2_1(edges(self.conv1_2(edges(f, 8)).amax(-1), 8)).amax(-1)
        out: Tensor = self.fc3_1(self.fc2_1(self.fc1_1(self.conv2_2(f + g).amax(-1))))
        return out


class ReleaseNetwork(nn.Module):
    """points, normals (B, M, 3) -> displacement (B, 3), normal (B, 3), weight (B, M), selected (B, K).

    Parameters
    ----------
    transpose : bool
        With the released code's transposed reading of the features that are averaged.
    """

    def __init__(self, transpose: bool = True) -> None:
        super().__init__()
        self.pointfeatEX, self.normalfeatEX = Extractor(), Extractor()
        self.weight = Selector()
        self.pointFeaFu, self.normalFeaFu = Augmentation(transpose), Augmentation(transpose)
        self.mlp1, self.normalDecoder = CoordinateRegressor(), NormalRegressor()

    def forward(self, points: Tensor, normals: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        f_p, p = self.pointfeatEX(points.transpose(1, 2))
        f_n, n = self.normalfeatEX(normals.transpose(1, 2))
        weight = self.weight(p, n, f_p, f_n)  # (B, M)
        selected = weight.topk(weight.shape[1] // 2, dim=-1).indices  # (B, K)
        index = nearest(p, 10).gather(1, selected[..., None].expand(-1, -1, 10))
        g_p = self.pointFeaFu(f_p, weight, selected, index)  # (B, 128, K)
        g_n = self.normalFeaFu(f_n, weight, selected, index)
        patch_p, patch_n = (f.amax(-1, keepdim=True).expand_as(g_p) for f in (f_p, f_n))
        displacement = self.mlp1(torch.cat([g_p, patch_p, g_n], 1))
        return displacement, self.normalDecoder(torch.cat([g_n + patch_n, g_p], 1)), weight, selected


def random_release(seed: int = 0) -> dict[str, Tensor]:
    """State dict of a released network with random weights and BatchNorm statistics, some scales negative."""
    generator = torch.Generator().manual_seed(seed)
    state = ReleaseNetwork().state_dict()
    for name, tensor in state.items():
        if name.endswith("num_batches_tracked"):
            continue
        noise = torch.randn(tensor.shape, generator=generator)
        if name.endswith("running_var"):
            state[name] = 0.5 + noise.abs()
        elif tensor.ndim > 1:
            state[name] = noise * (1.5 / tensor.shape[1]) ** 0.5
        elif name.endswith("weight"):
            state[name] = torch.where(noise < -1, -1.0, 1.0) * (0.75 + 0.25 * noise.abs())
        else:
            state[name] = 0.2 * noise
    return state
