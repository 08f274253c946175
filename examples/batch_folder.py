"""Every cloud of a folder, denoised in this process, without a service. Finished files are skipped when run again.

python examples/batch_folder.py scans clean
"""

from __future__ import annotations

import sys
from pathlib import Path

from pcdnf import Denoiser
from pcdnf.errors import PcdnfError
from pcdnf.file_formats import SUFFIXES
from pcdnf.formats import read, write


def main() -> int:
    """Denoise what is there; return 1 where something could not be."""
    source, target = Path(sys.argv[1]), Path(sys.argv[2])
    denoiser = Denoiser.load()  # once for all files
    failed = 0
    for path in sorted(path for path in source.rglob("*") if path.suffix.lower() in SUFFIXES):
        result = target / path.relative_to(source)
        if result.exists():
            print(f"{path}: already there")
            continue
        result.parent.mkdir(parents=True, exist_ok=True)
        try:
            cloud = read(path)
            done = denoiser.denoise(cloud.points, iterations=2)
            write(result, cloud.replaced(done.points, done.normals, metadata=done.metadata))
        except PcdnfError as error:
            print(f"{path}: {error} {error.hint or ''}", file=sys.stderr)
            failed += 1
        else:
            print(f"{path}: {len(cloud):,} points")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
