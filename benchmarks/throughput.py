"""How fast: the networks' forms in turns, and whole passes over clouds of several sizes.

    python benchmarks/throughput.py                                     # patches a second of each form, modules
    python benchmarks/throughput.py --parts scaling --points 10000,100000,1000000 --threads 1,2
    python benchmarks/throughput.py --parts tiles --points 10000000     # ten million points, three tiles of them

``forms``: the forms take turns within each round, so that whatever else the machine does hits all of them; the ratios
are medians over the rounds, to the edge-building form as torch allocates its memory, and with freed memory kept, as
ours do in use; a third row has it in the small batches that suit its caches best. ``modules``: microseconds a patch in
each module and each kernel of the folded networks, on one thread. ``scaling``: one pass from file to file in a process
of its own (``cloud_run.py``) for each size and number of threads, with seconds of each stage, of the wall and (of the
processor), and the peak of memory; ``tiles``: the set-up of a large cloud and some of its tiles. Measure on an idle
machine: others' load slows forms with many short parallel loops most.
Where it is not idle, seconds of the processor say more.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

import torch
import torch.nn.functional as F
from numba.core.dispatcher import Dispatcher
from reference import ReleaseNetwork, random_release
from stages import Stages
from torch import Tensor, nn

from pcdnf.models.authors_weights import convert_release
from pcdnf.models.build import build_network
from pcdnf.models.checkpoint import load_checkpoint
from pcdnf.models.config import NetworkConfig
from pcdnf.models.cpu.allocator import keep_freed_memory
from pcdnf.models.cpu.folded import FoldedPCDNF, fold
from pcdnf.models.cpu.folded_layers import Affine
from pcdnf.models.cpu.folded_lite import FoldedLite
from pcdnf.models.cpu.kernels import anchor as anchor_kernels
from pcdnf.models.cpu.kernels import lite as lite_kernels
from pcdnf.models.cpu.kernels import pcdnf as pcdnf_kernels
from pcdnf.models.cpu.kernels import quadric as quadric_kernels
from pcdnf.models.ops import knn_numba
from pcdnf.models.pcdnf import PCDNF

PARTS = ("forms", "modules", "scaling", "tiles")
MODULES = ("points", "normals", "score", "augment_points", "augment_normals", "coordinate", "normal")
KERNELS = (pcdnf_kernels, anchor_kernels, quadric_kernels, lite_kernels, knn_numba)
"""Modules whose compiled functions are timed one by one."""
PLAIN_BATCH = 4
"""The edges of more patches do not stay in the caches."""
LIGHT_BATCH = 512
"""Patches a batch of the light network."""


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


def kernels(network: nn.Module, points: Tensor, normals: Tensor) -> dict[str, float]:
    """Microseconds a patch in the products, in each kernel, and in all that stands between; on one thread."""
    stages = Stages()
    stages.watch(Affine, "__call__", "products")
    for module in KERNELS:
        for name, kernel in list(vars(module).items()):
            if isinstance(kernel, Dispatcher) and not name.startswith("_"):
                stages.watch(module, name, name)
    try:
        stages.timed(network, "the rest")(points, normals)
    finally:
        stages.end()
    return {name: 1e6 * float(seconds[1]) / len(points) for name, seconds in stages.seconds.items()}


def edge_building() -> ReleaseNetwork:
    """The reference, with weights of its own."""
    plain = ReleaseNetwork(transpose=False).eval()
    plain.load_state_dict(random_release())
    return plain


class Elsewhere(nn.Module):
    """The edge-building form in a process that allocates as torch does, without :func:`keep_freed_memory`."""

    def __init__(self, threads: int) -> None:
        super().__init__()
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=work_for, args=(theirs, threads), daemon=True)
        self._process.start()

    def forward(self, points: Tensor, normals: Tensor) -> None:
        self._pipe.send((points.numpy(), normals.numpy()))
        self._pipe.recv()


def work_for(pipe: Any, threads: int) -> None:
    """Run the edge-building form on what comes through the pipe."""
    torch.set_num_threads(threads)
    plain = edge_building()
    with suppress(EOFError), torch.inference_mode():
        while True:
            plain(*map(torch.from_numpy, pipe.recv()))
            pipe.send(None)


def make_forms(batch: int, threads: int) -> dict[str, tuple[nn.Module, int, int]]:
    """Each form, its patches a batch and its points a patch."""
    plain = edge_building()
    network = PCDNF(NetworkConfig()).eval()
    network.load_state_dict(convert_release(random_release()))
    info, state = load_checkpoint("pcdnf-lite")
    light = build_network(info.kind, info.config).eval()
    light.load_state_dict(state)
    few = int(info.recipe["points"])
    return {
        "edge-building": (Elsewhere(threads), batch, 512),
        "edge-building, memory kept": (plain, batch, 512),
        f"edge-building, memory kept, by {PLAIN_BATCH}": (plain, PLAIN_BATCH, 512),
        "unfolded float32": (network, batch, 512),
        "folded float32": (fold(network), batch, 512),
        "folded bfloat16": (fold(network, torch.bfloat16), batch, 512),
        "light float32": (light, LIGHT_BATCH, few),
        "light bfloat16": (Autocast(light), LIGHT_BATCH, few),
        "light folded float32": (FoldedLite(light), LIGHT_BATCH, few),
        "light folded bfloat16": (FoldedLite(light, torch.bfloat16), LIGHT_BATCH, few),
    }


class Autocast(nn.Module):
    """A network as torch itself runs it in bfloat16."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, *given: Tensor) -> Any:
        with torch.autocast("cpu", torch.bfloat16):
            return self.network(*given)


def time_forms(rounds: int, batch: int, threads: int) -> None:
    """Patches a second of each form, and how many times those of the first and of the second."""
    forms = make_forms(batch, threads)
    given = {name: random_patches(max(size, batch), points) for name, (_, size, points) in forms.items()}
    for name, (form, size, _) in forms.items():  # compile
        in_batches(form, *(x[:size] for x in given[name]), size)
    rates: dict[str, list[float]] = {name: [] for name in forms}
    for _ in range(rounds):
        for name, (form, size, _) in forms.items():
            count = len(given[name][0])
            rates[name].append(count / timed(partial(in_batches, form, *given[name], size)))
    first, second, *_ = rates.values()
    print(f"{threads} threads, {rounds} rounds of {batch} patches of 512 points, {LIGHT_BATCH} of the light network's")
    for name, values in rates.items():
        ratios = [median(value / base for value, base in zip(values, by, strict=True)) for by in (first, second)]
        print(f"{name:32}{median(values):8.1f} patches/s {ratios[0]:7.2f} x {ratios[1]:7.2f} x")


def time_modules(rounds: int, batch: int) -> None:
    """Microseconds a patch in the modules and the kernels of the folded forms."""
    torch.set_num_threads(1)
    for name, (form, size, points) in make_forms(batch, 1).items():
        if "folded" not in name or "unfolded" in name:
            continue
        given = random_patches(size, points)
        form(*given)
        for split in (breakdown, kernels) if isinstance(form, FoldedPCDNF) else (kernels,):
            runs = [split(form, *given) for _ in range(rounds)]
            parts = {part: median(run[part] for run in runs) for part in runs[0]}
            shown = ", ".join(f"{part} {spent:.0f}" for part, spent in sorted(parts.items(), key=lambda x: -x[1]))
            print(f"{name}, {split.__name__}, us a patch on one thread: {shown}")


def time_clouds(points: list[int], threads: list[int], model: str, tiles: int) -> None:
    """One pass over each cloud in a process of its own."""
    for count in points:
        for number in threads:
            began = time.perf_counter()
            options = ["--points", str(count), "--threads", str(number), "--model", model, "--tiles", str(tiles)]
            script = Path(__file__).with_name("cloud_run.py")
            ended = subprocess.run([sys.executable, script, *options], check=True, stdout=subprocess.PIPE)
            run = json.loads(ended.stdout)
            stages = ", ".join(f"{name} {spent[0]:.1f} ({spent[1]:.1f})" for name, spent in run["stages"].items())
            print(
                f"{count:,} points, {number} threads, {model} in {run['precision']}: set-up {run['setup'][0]:.1f} s, "
                f"in all {run['seconds'][0]:.1f} s ({run['seconds'][1]:.1f} of the processor), "
                f"{run['points_per_second']:,.0f} points/s ({run['points_per_processor_second']:,.0f} processor), "
                f"peak {run['peak_gib']:.2f} GiB; imports {run['import'][0]:.1f} s, process "
                f"{time.perf_counter() - began:.1f} s with making the cloud\n  {stages}",
                flush=True,
            )


def names(text: str) -> list[str]:
    return text.split(",")


def numbers(text: str) -> list[int]:
    return [int(float(value)) for value in text.split(",")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", type=names, default=["forms", "modules"], help=", ".join(PARTS))
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--batch", type=int, default=32, help="patches a round")
    parser.add_argument("--threads", type=numbers, default=[torch.get_num_threads()], help="of `scaling`: some, 1,2")
    parser.add_argument("--points", type=numbers, default=[10_000, 100_000], help="of the clouds: 1e4,1e5,1e6")
    parser.add_argument("--model", default="pcdnf-lite", help="of the clouds")
    parser.add_argument("--tiles", type=int, default=3, help="of `tiles`")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads[-1])
    keep_freed_memory()  # as in use
    if "forms" in arguments.parts:
        time_forms(arguments.rounds, arguments.batch, arguments.threads[-1])
    if "modules" in arguments.parts:
        time_modules(arguments.rounds, arguments.batch)
    if "scaling" in arguments.parts:
        time_clouds(arguments.points, arguments.threads, arguments.model, 0)
    if "tiles" in arguments.parts:
        time_clouds(arguments.points, arguments.threads, arguments.model, arguments.tiles)


if __name__ == "__main__":
    main()
