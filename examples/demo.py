"""The main job end to end: start the service, upload a cloud, follow the job, fetch and draw the result.

    scripts/demo [FILE] [--iterations N] [--output FOLDER]

Without a file it takes the sample bracket, whose clean form is known, and prints how far from it the points are.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from tqdm import tqdm

from pcdnf.formats import PointCloud, read
from pcdnf.metrics import score
from pcdnf.render.panels import render_comparison

FOLDER = Path(__file__).parent
START_SECONDS = 180


def start(data: Path) -> tuple[subprocess.Popen[str], str]:
    """Start the service on a free port; return its process and address."""
    command = [sys.executable, "-m", "service", "--port", "0", "--data-dir", str(data)]
    with (data / "service.log").open("w") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        found = re.search(r"http://\S+", line)
        if found:
            return process, found[0]
    raise SystemExit("The service did not start:\n" + (data / "service.log").read_text())


def wait_until_ready(client: httpx.Client) -> dict[str, Any]:
    """Wait for a worker that has run its model once."""
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline:
        answer = client.get("/readyz")
        if answer.status_code == 200:
            health: dict[str, Any] = answer.json()
            return health
        time.sleep(0.3)
    raise SystemExit(f"The service was not ready after {START_SECONDS} seconds: {answer.text}")


def follow(client: httpx.Client, job: dict[str, Any]) -> dict[str, Any]:
    """Show the job's progress until it has ended."""
    with tqdm(total=job["progress"]["total"], unit=" points", unit_scale=True, desc="denoising") as bar:
        while job["status"] in ("queued", "running"):
            time.sleep(0.5)
            job = client.get(job["links"]["self"]).raise_for_status().json()
            bar.total = job["progress"]["total"]
            bar.update(job["progress"]["done"] - bar.n)
    if job["status"] != "succeeded":
        problem = job.get("problem") or {}
        raise SystemExit(f"The job {job['status']}: {problem.get('detail', '')} {problem.get('hint', '')}")
    return job


def report(before: PointCloud, after: PointCloud, clean: PointCloud | None) -> list[str]:
    """What changed, in lines for a person, and what the file carried that must come back."""
    for name, column in before.attributes.items():
        assert np.array_equal(column, after.attributes[name]), name
    carried = ", ".join(before.attributes) or "nothing"
    step = np.linalg.norm(after.points.astype(np.float64) - before.points, axis=1)
    diagonal = np.linalg.norm(np.ptp(before.points.astype(np.float64), axis=0))
    lines = [
        f"{len(after.points):,} points came back in order, with normals; carried along: {carried}",
        f"moved by {step.mean():.4g} on average, {100 * step.mean() / diagonal:.3f} % of the diagonal",
    ]
    if clean is not None:
        for label, cloud in (("before", before), ("after", after)):
            scores = score(cloud.points, cloud.normals, clean.points, clean.normals)
            line = f"{label:<7} CD {scores.chamfer_distance:6.2f} e-5   P2S {scores.point_to_surface:6.2f} e-3"
            lines.append(line if scores.normal_mean is None else f"{line}   normals {scores.normal_mean:.1f} degrees")
    return lines


def main() -> None:
    """Run the demo."""
    parser = argparse.ArgumentParser(prog="scripts/demo", description="Denoise a cloud through the service.")
    parser.add_argument("file", nargs="?", type=Path, default=FOLDER / "bracket_noisy.ply")
    parser.add_argument("--iterations", default="auto")
    parser.add_argument("--output", type=Path, default=Path("demo-output"))
    arguments = parser.parse_args()
    source: Path = arguments.file
    sample = source == FOLDER / "bracket_noisy.ply"
    arguments.output.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="pcdnf-demo-") as folder:
        process, address = start(Path(folder))
        try:
            with httpx.Client(base_url=address, timeout=600) as client:
                worker = wait_until_ready(client)["workers"][0]
                print(f"service ready at {address} after {time.monotonic() - began:.1f} s, device {worker['device']}")
                with source.open("rb") as file:
                    answer = client.post(
                        "/denoise", files={"file": (source.name, file)}, params={"iterations": arguments.iterations}
                    )
                if answer.is_error:
                    problem = answer.json()
                    raise SystemExit(f"{problem['detail']} {problem.get('hint') or ''}")
                began = time.monotonic()
                job = follow(client, answer.json())
                passes = len(job["execution"]["plan"]["radii"])
                print(f"denoised in {time.monotonic() - began:.1f} s; passes over the cloud: {passes}")
                result = client.get(job["links"]["result"]).raise_for_status()
        finally:
            process.terminate()
            status = process.wait(60)
    target = arguments.output / f"{source.stem}_denoised{source.suffix}"
    target.write_bytes(result.content)
    before, after = read(source), read(target)
    clean = read(FOLDER / "bracket_clean.ply") if sample else None
    print(*report(before, after, clean), sep="\n")
    picture = target.with_suffix(".png")
    render_comparison(before, after, picture, title=source.name)
    print(f"wrote {target} and {picture}")
    if status != 0:
        raise SystemExit(f"The service ended with status {status}.")


if __name__ == "__main__":
    main()
