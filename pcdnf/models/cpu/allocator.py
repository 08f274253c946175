"""One setting of the C library's allocator that decides half of the run time on a CPU."""

from __future__ import annotations

import ctypes
import sys

_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3
KEEP = 1 << 30
"""Bytes of freed memory the process may keep for its next batch."""


def keep_freed_memory() -> bool:
    """Let glibc reuse the temporaries of the last batch instead of returning them to the kernel.

    A batch's temporaries are some megabytes each. By default every one of them is mapped, touched for the first time
    (a page fault each 4 KiB) and unmapped again, which takes as long as the arithmetic. Process-wide; affects
    memory kept, not results.

    Returns
    -------
    bool
        Whether it took effect; False without glibc.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except AttributeError:
        return False
    settings = ((_M_MMAP_THRESHOLD, 1 << 25), (_M_TRIM_THRESHOLD, KEEP), (_M_TOP_PAD, 1 << 26))
    return all(mallopt(key, value) == 1 for key, value in settings)
