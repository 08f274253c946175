import re
import sys
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))  # it is run from there

import stages
import throughput

from pcdnf.models.cpu.folded_lite import FoldedLite
from pcdnf.models.lite import PCDNFLite


def test_a_stage_inside_another_is_not_counted_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(stages, "now", lambda: stages.np.full(2, clock[0]))
    watch = stages.Stages()

    def spend(seconds: float) -> None:
        clock[0] += seconds

    inner = watch.timed(spend, "inner")

    def outer() -> None:
        spend(1)
        inner(2)
        inner(3)

    watch.timed(outer, "outer")()
    assert {name: seconds[0] for name, seconds in watch.seconds.items()} == {"inner": 5.0, "outer": 1.0}


def test_kernels_leaves_the_modules_as_they_were() -> None:
    before = dict(vars(throughput.lite_kernels))
    network, given = FoldedLite(PCDNFLite()), throughput.random_patches(4, 64)
    expected = network(*given).displacement
    parts = throughput.kernels(network, *given)
    assert {"products", "embed", "normalise", "against", "fit_patches", "the rest"} <= set(parts)
    assert min(parts.values()) >= 0
    assert vars(throughput.lite_kernels) == before
    assert torch.equal(network(*given).displacement, expected)


@pytest.mark.full
def test_forms_take_turns_and_are_taken_apart(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(throughput, "LIGHT_BATCH", 8)
    monkeypatch.setattr(sys, "argv", ["throughput.py", "--rounds", "1", "--batch", "4", "--threads", "1"])
    throughput.main()
    shown = capsys.readouterr().out
    rates = dict(re.findall(r"^(.+?) +([\d.]+) patches/s", shown, re.MULTILINE))
    assert len(rates) == 10
    assert float(rates["folded float32"]) > 5 * float(rates["edge-building"])
    assert shown.count("breakdown, us a patch on one thread: ") == 2
    assert shown.count("kernels, us a patch on one thread: ") == 4
    assert {"select_features", "products", "edge_conv", "the rest"} <= set(
        re.findall(r"[a-z_]+(?: rest)?(?= \d)", shown)
    )


@pytest.mark.full
@pytest.mark.parametrize("tiles", [0, 1])
def test_one_pass_in_a_process_of_its_own(tiles: int, capsys: pytest.CaptureFixture[str]) -> None:
    throughput.time_clouds([800], [1], "pcdnf-lite", tiles)
    shown = capsys.readouterr().out
    assert shown.startswith("800 points, 1 threads, pcdnf-lite in ")
    assert "peak 0." in shown
    assert ("writing" in shown) == (tiles == 0)
    assert "network" in shown
