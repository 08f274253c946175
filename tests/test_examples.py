"""Every example does what its first lines say."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcdnf.formats import read
from tests.support.service_process import KEY, Service, sphere, write_sphere

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
COUNT = 1500


def run(*command: object, status: int = 0, **environment: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [str(word) for word in command], env=os.environ | environment, capture_output=True, text=True, timeout=240
    )
    assert done.returncode == status, done.stdout + done.stderr
    return done


def error(path: Path) -> float:
    """Mean distance to the sphere that the clouds of these tests are of."""
    return float(np.abs(np.linalg.norm(read(path).points, axis=1) - 1).mean())


def of(service: Service, **more: str) -> dict[str, str]:
    return {"PCDNF_URL": str(service.client.base_url).rstrip("/"), "PCDNF_API_KEY": KEY} | more


def test_denoise_sh(keyed: Service, tmp_path: Path) -> None:
    scan = write_sphere(tmp_path / "scan.ply", COUNT)
    assert run(EXAMPLES / "denoise.sh", scan, **of(keyed)).stdout == f"{tmp_path / 'scan_denoised.ply'}\n"
    assert error(tmp_path / "scan_denoised.ply") < 0.8 * error(scan)
    scan.write_text("no cloud")
    refused = run(EXAMPLES / "denoise.sh", scan, tmp_path / "out.ply", status=1, **of(keyed))
    assert "The format of the file is unknown" in refused.stderr
    assert KEY not in refused.stdout + refused.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scan.ply", "scan_denoised.ply"]


def test_python_client(keyed: Service, tmp_path: Path) -> None:
    scan = write_sphere(tmp_path / "scan.ply", COUNT)
    done = run(sys.executable, EXAMPLES / "python_client.py", scan, tmp_path / "clean.ply", **of(keyed))
    assert "succeeded: 100%" in done.stdout
    assert error(tmp_path / "clean.ply") < 0.8 * error(scan)
    refused = run(
        sys.executable, EXAMPLES / "python_client.py", scan, tmp_path / "x.ply", status=1,
        **of(keyed, PCDNF_API_KEY="another-key-of-nobody"),
    )  # fmt: skip
    assert "requires an API key" in refused.stderr
    assert "Traceback" not in refused.stderr


@pytest.mark.full
def test_batch_folder(tmp_path: Path) -> None:
    (tmp_path / "scans" / "sub").mkdir(parents=True)
    first = write_sphere(tmp_path / "scans" / "a.ply", COUNT)
    write_sphere(tmp_path / "scans" / "sub" / "b.npz", COUNT, seed=1)
    (tmp_path / "scans" / "bad.ply").write_text("ply\n")
    (tmp_path / "scans" / "notes.md").write_text("not a cloud")
    command = (sys.executable, EXAMPLES / "batch_folder.py", tmp_path / "scans", tmp_path / "clean")
    done = run(*command, status=1)
    assert "bad.ply: " in done.stderr
    assert error(tmp_path / "clean" / "a.ply") < 0.8 * error(first)
    assert len(read(tmp_path / "clean" / "sub" / "b.npz")) == COUNT
    assert run(*command, status=1).stdout.count("already there") == 2


@pytest.mark.full
def test_open3d_mesh(tmp_path: Path) -> None:
    scan = write_sphere(tmp_path / "scan.ply", 3000)
    run(sys.executable, EXAMPLES / "open3d_mesh.py", scan, tmp_path / "mesh.ply")
    mesh = trimesh.load_mesh(tmp_path / "mesh.ply")
    radii = np.linalg.norm(np.asarray(mesh.vertices), axis=1)
    assert len(mesh.faces) > 5000
    assert np.abs(radii - 1).mean() < 0.5 * np.abs(np.linalg.norm(sphere(3000), axis=1) - 1).mean()


def test_the_readme_names_every_example() -> None:
    text = (EXAMPLES / "README.md").read_text()
    scripts = [path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".sh")]
    assert [name for name in scripts if f"`{name}`" not in text] == []
