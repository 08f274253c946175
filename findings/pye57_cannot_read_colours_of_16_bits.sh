#!/usr/bin/env bash
# One would expect: colours of an E57, which the standard lets have any bounds, are read by pye57's read_scan whatever
# their bounds, or as the colorLimits of the scan say.
# What happens (pye57 0.4.19): read_scan puts colours into uint8 arrays. A scan with colours from 0 to 65535, whose
# colorLimits say so, raises an error of libE57; one with colours from 0 to 255 is read.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pye57==0.4.19 numpy==2.3.5
venv/bin/python - <<'PYTHON'
import importlib.metadata
import sys

import numpy as np
import pye57
from pye57 import libe57

NAMES = ("colorRed", "colorGreen", "colorBlue")
AXES = ("cartesianX", "cartesianY", "cartesianZ")
COUNT = 20


def write(path, top):
    """One scan whose colours go from 0 to ``top``; its arrays are kept until the file is closed."""
    image = libe57.ImageFile(path, "w")
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    data = libe57.VectorNode(image, True)
    image.root().set("data3D", data)
    scan = libe57.StructureNode(image)
    data.append(scan)
    scan.set("guid", libe57.StringNode(image, "{scan}"))
    limits = libe57.StructureNode(image)
    for name in NAMES:
        limits.set(f"{name}Minimum", libe57.IntegerNode(image, 0))
        limits.set(f"{name}Maximum", libe57.IntegerNode(image, top))
    scan.set("colorLimits", limits)
    prototype = libe57.StructureNode(image)
    arrays = {name: np.arange(COUNT, dtype=float) for name in AXES}
    arrays |= {name: np.full(COUNT, top, np.uint16) for name in NAMES}
    for name in AXES:
        prototype.set(name, libe57.FloatNode(image, 0.0))
    for name in NAMES:
        prototype.set(name, libe57.IntegerNode(image, 0, 0, top))
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    scan.set("points", points)
    buffers = libe57.VectorSourceDestBuffer()
    for name, values in arrays.items():
        buffers.append(libe57.SourceDestBuffer(image, name, values, COUNT, True, True))
    writer = points.writer(buffers)
    writer.write(COUNT)
    writer.close()
    image.close()


def colours(path):
    """The first red that read_scan finds, or the kind of its error."""
    with pye57.E57(path) as file:
        try:
            return int(file.read_scan(0, colors=True, ignore_missing_fields=True)["colorRed"][0])
        except Exception as error:
            return type(error).__name__


print("pye57", importlib.metadata.version("pye57"))
found = {}
for top in (255, 65535):
    write("a.e57", top)
    found[top] = colours("a.e57")
    print(f"colours of {top} come back as {found[top]}")
expected = found[255] == 255 and found[65535] != 65535
sys.exit(0 if expected else "the behaviour has changed")
PYTHON
