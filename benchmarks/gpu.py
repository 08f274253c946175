"""What a GPU does: kernels against plain torch, patches a second of both networks, a pass over a cloud.

    python benchmarks/gpu.py [--points 100000]

Needs CUDA. Every comparison is of one run; times are medians.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import asdict

import numpy as np
import torch
from torch.nn import functional as F
from triton.testing import do_bench

from pcdnf import Denoiser
from pcdnf.models.build import build_network
from pcdnf.models.ops import neighbours
from pcdnf.models.ops import triton as triton_kernels
from pcdnf.training.defaults import DEFAULTS
from pcdnf.training.losses import Batch, Surface, joint_loss


def compare(name: str, ours: Callable[[], object], plain: Callable[[], object]) -> None:
    """Print two times and their ratio."""
    fast, slow = do_bench(ours, return_mode="median"), do_bench(plain, return_mode="median")
    print(f"{name:28} Triton {fast:7.3f} ms, plain {slow:7.3f} ms, {slow / fast:5.1f} x")


def kernels() -> None:
    """256 patches of 512 points."""
    for channels, k in ((3, 16), (64, 16), (128, 8)):
        x = torch.randn(256, 512, channels, device="cuda")
        compare(
            f"graph of {k} in {channels} channels",
            lambda x=x, k=k: triton_kernels.knn(x, k, None),
            lambda x=x, k=k: neighbours.knn_plain(x, k),
        )
    values = torch.randn(256, 512, 64, device="cuda", requires_grad=True)
    graph = neighbours.knn(torch.randn(256, 512, 3, device="cuda"), 16)
    ours, plain = triton_kernels.GatherMax.apply(values, graph), neighbours.gather_max_plain(values, graph)
    compare(
        "gathered maximum",
        lambda: triton_kernels.GatherMax.apply(values, graph),
        lambda: neighbours.gather_max_plain(values, graph),
    )
    change = torch.randn_like(ours)
    compare(
        "its gradient",
        lambda: torch.autograd.grad(ours, values, change, retain_graph=True),
        lambda: torch.autograd.grad(plain, values, change, retain_graph=True),
    )


def patches(size: int, points: int) -> Batch:
    """Random patches with a made-up surface."""
    stretch, up = torch.tensor([0.5, 0.5, 0.1], device="cuda"), torch.tensor([0.0, 0.0, 2.0], device="cuda")
    local = torch.randn(size, points, 3, device="cuda") * stretch
    local[:, 0] = 0
    normals = F.normalize(torch.randn(size, points, 3, device="cuda") + up, dim=-1)
    return Batch(local, normals, Surface(0.9 * local[:, :96], normals[:, :96]), 0.9 * local, normals)


def networks() -> None:
    """Training steps and inference under bfloat16 autocast."""
    for kind, points, size in (("pcdnf", 512, 512), ("lite", 256, 4096)):
        defaults, batch = DEFAULTS[kind], patches(size, points)
        network = build_network(kind, asdict(defaults.config)).cuda()
        optimizer = torch.optim.AdamW(network.parameters())

        def step(network=network, batch=batch, defaults=defaults, optimizer=optimizer) -> None:
            with torch.autocast("cuda", torch.bfloat16):
                output = network(batch.points, batch.normals)
            loss, _ = joint_loss(output, batch, defaults.losses)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()

        def infer(network=network, batch=batch) -> None:
            with torch.inference_mode(), torch.autocast("cuda", torch.bfloat16):
                network(batch.points, batch.normals)

        training = do_bench(step, return_mode="median")
        network.eval()
        inference = do_bench(infer, return_mode="median")
        rate, infer_rate = size / training * 1e3, size / inference * 1e3
        print(f"{kind}: training {rate:,.0f}, inference {infer_rate:,.0f} patches/s in batches of {size}")


def cloud(count: int) -> None:
    """One pass of each model over a noisy sheet, its stages apart."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (count, 3))
    points[:, 2] = 0.1 * np.sin(6 * points[:, 0]) + 0.003 * rng.normal(size=count)
    for name in ("pcdnf-lite", "pcdnf"):
        denoiser = Denoiser.load(name, device="cuda")
        denoiser.warm_up()
        torch.cuda.reset_peak_memory_stats()
        marks = [time.perf_counter()]
        prepared = denoiser.prepare(points)
        marks.append(_now())
        batch = prepared.source.take(prepared.order[: denoiser.batch])
        marks.append(_now())
        denoiser.network(torch.as_tensor(batch.points), torch.as_tensor(batch.normals))
        marks.append(_now())
        denoiser.denoise(points, iterations=1)
        marks.append(_now())
        prepare, take, network, whole = np.diff(marks)
        memory = torch.cuda.max_memory_allocated() / 2**30
        print(
            f"{name}: {count:,} points in {whole:.2f} s, of which {prepare:.2f} s before the first batch; a batch of"
            f" {denoiser.batch}: patches {take * 1e3:.1f} ms, network {network * 1e3:.1f} ms; {memory:.1f} GiB"
        )


def _now() -> float:
    torch.cuda.synchronize()
    return time.perf_counter()


def main() -> None:
    """All of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=100_000)
    arguments = parser.parse_args()
    print(torch.cuda.get_device_name(), torch.__version__)
    kernels()
    networks()
    cloud(arguments.points)


if __name__ == "__main__":
    main()
