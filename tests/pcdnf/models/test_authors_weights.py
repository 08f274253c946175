from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from benchmarks.reference import ReleaseNetwork, random_release
from pcdnf.errors import PcdnfError
from pcdnf.models.authors_weights import CONFIG, convert_release, read_release
from pcdnf.models.cpu.folded import fold
from pcdnf.models.pcdnf import PCDNF


def imported(tensors: dict[str, Tensor]) -> PCDNF:
    network = PCDNF(CONFIG).eval()
    network.load_state_dict(convert_release(tensors))
    return network


def patches(B: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(B)
    points = torch.randn(B, 512, 3, generator=generator) * 0.3
    return points, F.normalize(torch.randn(B, 512, 3, generator=generator), dim=-1)


@pytest.mark.parametrize("folded", [False, True])
def test_agrees_with_an_edge_building_network_under_the_released_names(folded: bool) -> None:
    tensors = random_release(seed=1)
    assert any((tensor < 0).any() for name, tensor in tensors.items() if name.endswith("_1.1.weight"))
    plain = ReleaseNetwork().eval()
    plain.load_state_dict(tensors)
    network = imported(tensors)
    points, normals = patches(3)
    with torch.inference_mode():
        *exact, selected = plain.double()(points.double(), normals.double())
        output = (fold(network) if folded else network)(points, normals)
    displacement, normal, weight = (x.float() for x in exact)
    torch.testing.assert_close(output.displacement, displacement, rtol=0, atol=1e-3)
    torch.testing.assert_close(output.normal, normal, rtol=0, atol=1e-3)
    torch.testing.assert_close(output.weight, weight, rtol=0, atol=1e-3)
    assert torch.equal(output.selected.sort().values, selected.sort().values)


def test_transposed_reading_matters() -> None:
    tensors = random_release()
    points, normals = patches(1)
    with torch.inference_mode():
        results = []
        for transpose in (True, False):
            plain = ReleaseNetwork(transpose).eval()
            plain.load_state_dict(tensors)
            results.append(plain(points, normals)[1])
    assert (results[0] - results[1]).abs().max() > 1e-2


@pytest.mark.parametrize("form", ["network", "folded", "reference"])
def test_agrees_with_the_released_code(shared_data: Path, form: str) -> None:
    vector = {name: torch.from_numpy(array) for name, array in np.load(shared_data / "release_vector.npz").items()}
    tensors = read_release(shared_data / "release_vector.pth")
    with torch.inference_mode():
        if form == "reference":
            plain = ReleaseNetwork().eval()
            plain.load_state_dict(tensors, strict=False)  # the release has layers that it does not use
            displacement, normal, weight, selected = plain(vector["points"], vector["normals"])
        else:
            network = imported(tensors)
            output = (fold(network) if form == "folded" else network)(vector["points"], vector["normals"])
            displacement, normal, weight, selected, *_ = output
    torch.testing.assert_close(displacement, vector["displacement"], rtol=0, atol=1e-3)
    torch.testing.assert_close(normal, vector["normal"], rtol=0, atol=1e-3)
    torch.testing.assert_close(weight, vector["weight"], rtol=0, atol=1e-3)
    assert torch.equal(selected.sort().values, vector["selected"].sort().values)


def test_missing_tensor() -> None:
    tensors = random_release()
    del tensors["weight.fc3.0.weight"]
    with pytest.raises(PcdnfError, match=r"no tensor 'weight\.fc3\.0\.weight'") as caught:
        convert_release(tensors)
    assert caught.value.code == "release_tensor_missing"


def test_tensor_of_another_shape() -> None:
    tensors = random_release()
    tensors["mlp1.conv.0.weight"] = tensors["mlp1.conv.0.weight"][:, :256]
    with pytest.raises(PcdnfError, match=r"shape \(512, 256, 1\); the released network has \(512, 384\)") as caught:
        convert_release(tensors)
    assert caught.value.code == "release_tensor_shape"


def test_reads_a_checkpoint_as_the_release_writes_it(tmp_path: Path) -> None:
    tensors = random_release()
    torch.save({"epoch": 3, "state_dict": tensors, "optimizer": {"state": {}}}, tmp_path / "release.pth")
    read = read_release(tmp_path / "release.pth")
    assert read.keys() == tensors.keys()
    assert all(torch.equal(read[name], tensors[name]) for name in tensors)


class Harmful:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return print, ("executed",)


@pytest.mark.parametrize("content", ["absent", "text", "no state", "not tensors", "code", "bare pickle"])
def test_refuses_other_files(tmp_path: Path, content: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "other.pth"
    match content:
        case "text":
            path.write_text("ply\nformat ascii 1.0\n")
        case "no state":
            torch.save({"epoch": 3}, path)
        case "not tensors":
            torch.save({"state_dict": {"a": 1}}, path)
        case "code":
            torch.save({"state_dict": {"a": Harmful()}}, path)
        case "bare pickle":
            path.write_bytes(pickle.dumps(Harmful()))
    with pytest.raises(PcdnfError, match=r"'other\.pth' is not a checkpoint of the released PCDNF code") as caught:
        read_release(path)
    assert caught.value.code == "release_unreadable"
    assert "executed" not in capsys.readouterr().out
