#!/usr/bin/env bash
# One would expect: a pye57 SourceDestBuffer keeps the numpy array it was made from alive, and numpy's int64 is
# written as 64-bit integers while int32 is the safe, common type.
# What happens (pye57 0.4.19, Linux x86_64): the buffer keeps no reference to its array (the reference count does not
# grow), so an array that Python frees before writer.write() is written as whatever memory then holds. int64 arrays
# ("l" in the buffer protocol) are taken for 32 bits: every other number in the file is the upper half of one value.
# int32 ("i") is refused outright. numpy.longlong, of the same 64 bits, is "q" and is written correctly.
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
from pye57 import libe57

print("pye57", importlib.metadata.version("pye57"), "numpy", np.__version__)


def written(values):
    """The values of one integer field after writing and reading back, through a fixed longlong array for reading."""
    image = libe57.ImageFile("a.e57", "w")
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    prototype = libe57.StructureNode(image)
    prototype.set("rowIndex", libe57.IntegerNode(image, 0, 0, 2**40))
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    image.root().set("points", points)
    buffers = libe57.VectorSourceDestBuffer()
    before = sys.getrefcount(values)
    buffers.append(libe57.SourceDestBuffer(image, "rowIndex", values, len(values), True, True))
    kept = sys.getrefcount(values) - before
    writer = points.writer(buffers)
    writer.write(len(values))
    writer.close()
    image.close()
    image = libe57.ImageFile("a.e57", "r")
    back = np.zeros(len(values), np.longlong)
    buffers = libe57.VectorSourceDestBuffer()
    buffers.append(libe57.SourceDestBuffer(image, "rowIndex", back, len(back), True, True))
    reader = image.root()["points"].reader(buffers)
    reader.read()
    reader.close()
    image.close()
    return back, kept


numbers = np.arange(1000, 1008)
as_long, kept = written(numbers.astype(np.dtype("l")))
as_longlong, _ = written(numbers.astype(np.longlong))
print("references added by the buffer:", kept)
print("int64 (l) ", numbers.tolist(), "->", as_long.tolist())
print("longlong (q)", numbers.tolist(), "->", as_longlong.tolist())
refused = False
try:
    written(numbers.astype(np.int32))
except Exception as error:
    refused = True
    print("int32:", str(error).splitlines()[0][:90])
expected = kept == 0 and refused and as_long.tolist() == [1000, 0, 1001, 0, 1002, 0, 1003, 0]
expected = expected and as_longlong.tolist() == numbers.tolist()
sys.exit(0 if expected else "the behaviour has changed")
PYTHON
