"""Patches per second of the network: edge-building form, folded float32, folded bfloat16, in turns.

    python benchmarks/throughput.py [--rounds 7] [--batch 32] [--threads 2]

The forms take turns within each round, so that whatever else the machine does hits all of them; the ratios are
medians over the rounds, to the edge-building form in the same batches and in the small ones that suit its caches
best. Measure on an idle machine: others' load slows forms with many short parallel loops most. The breakdown
times each module of the folded forms by itself.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import torch
import torch.nn.functional as F
from reference import ReleaseNetwork, random_release
from torch import Tensor, nn

from pcdnf.folded import FoldedPCDNF
from pcdnf.network import PCDNF, NetworkConfig
from pcdnf.release import convert_release

MODULES = ("points", "normals", "score", "augment_points", "augment_normals", "coordinate", "normal")
PLAIN_BATCH = 4
"""The edges of more patches do not stay in the caches."""


def random_patches(count: int, points: int = 512) -> tuple[Tensor, Tensor]:
    """Noisy pieces of curved surfaces in their frame: points and normals (count, points, 3)."""
    generator = torch.Generator().manual_seed(0)
    xy = torch.rand(4 * points, 2, generator=generator) * 2 - 1
    xy = xy[xy.norm(dim=-1) < 1][:points].expand(count, -1, -1)
    bend = torch.randn(count, 1, 2, generator=generator) * 0.3
    noise = torch.randn(count, points, 3, generator=generator) * 0.05
    z = (bend * xy.square()).sum(-1, keepdim=True)
    normals = torch.cat([-2 * bend * xy, torch.ones_like(z)], -1)
    return torch.cat([xy, z], -1) + noise, F.normalize(normals + 4 * noise, dim=-1)


def timed(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def in_batches(network: nn.Module, points: Tensor, normals: Tensor, batch: int) -> None:
    with torch.inference_mode():
        for chunk in zip(points.split(batch), normals.split(batch), strict=True):
            network(*chunk)


class Stopwatch:
    """Stands in for a module of the folded network and adds up the time of its calls."""

    def __init__(self, module: Any) -> None:
        self.module, self.seconds = module, 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.module, name)

    def __call__(self, *args: Tensor) -> Any:
        start = time.perf_counter()
        out = self.module(*args)
        self.seconds += time.perf_counter() - start
        return out


def breakdown(network: FoldedPCDNF, points: Tensor, normals: Tensor) -> dict[str, float]:
    """Microseconds a patch in each module of a folded network; the rest is selector, augmentation's gathers, anchor."""
    watches = {name: Stopwatch(getattr(network, name)) for name in MODULES}
    for name, watch in watches.items():
        setattr(network, name, watch)
    total = timed(lambda: network(points, normals))
    for name, watch in watches.items():
        setattr(network, name, watch.module)
    parts = {name: watch.seconds for name, watch in watches.items()}
    parts["rest"] = total - sum(parts.values())
    return {name: 1e6 * seconds / len(points) for name, seconds in parts.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--batch", type=int, default=32, help="patches a round")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)

    release = random_release()
    plain = ReleaseNetwork(transpose=False).eval()
    plain.load_state_dict(release)
    network = PCDNF(NetworkConfig()).eval()
    network.load_state_dict(convert_release(release))
    points, normals = random_patches(arguments.batch)
    forms = {
        "edge-building": (plain, arguments.batch),
        f"edge-building, by {PLAIN_BATCH}": (plain, PLAIN_BATCH),
        "unfolded float32": (network, arguments.batch),
        "folded float32": (network.folded(), arguments.batch),
        "folded bfloat16": (network.folded(torch.bfloat16), arguments.batch),
    }
    for form, batch in forms.values():  # compile
        in_batches(form, points[:batch], normals[:batch], batch)
    rates: dict[str, list[float]] = {name: [] for name in forms}
    for _ in range(arguments.rounds):
        for name, (form, batch) in forms.items():
            rates[name].append(arguments.batch / timed(partial(in_batches, form, points, normals, batch)))

    same, small, *_ = rates.values()
    print(f"{arguments.threads} threads, {arguments.rounds} rounds of {arguments.batch} patches of 512 points")
    for name, values in rates.items():
        ratios = [median(value / base for value, base in zip(values, by, strict=True)) for by in (same, small)]
        print(f"{name:22}{median(values):8.1f} patches/s {ratios[0]:7.2f} x {ratios[1]:7.2f} x")
    for name in ("folded float32", "folded bfloat16"):
        torch.set_num_threads(1)
        runs = [breakdown(forms[name][0], points, normals) for _ in range(arguments.rounds)]
        parts = {part: median(run[part] for run in runs) for part in runs[0]}
        print(f"{name}, us a patch on one thread: " + ", ".join(f"{part} {spent:.0f}" for part, spent in parts.items()))


if __name__ == "__main__":
    main()
