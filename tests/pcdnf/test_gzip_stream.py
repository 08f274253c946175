from __future__ import annotations

import gzip

import pytest

from pcdnf.gzip_stream import PIECE_BYTES, GzipError, Inflater


def inflate(*chunks: bytes) -> bytes:
    inflater = Inflater()
    found = b"".join(piece for chunk in chunks for piece in inflater.feed(chunk))
    inflater.finish()
    return found


def test_a_stream_cut_anywhere() -> None:
    packed = gzip.compress(b"first") + gzip.compress(b"second")
    for size in (1, 2, 7, 1000):
        assert inflate(*(packed[at : at + size] for at in range(0, len(packed), size))) == b"firstsecond"
    assert inflate() == b""


def test_pieces_are_small_however_much_there_is() -> None:
    pieces = list(Inflater().feed(gzip.compress(bytes(5 * PIECE_BYTES))))
    assert max(map(len, pieces)) <= PIECE_BYTES
    assert sum(map(len, pieces)) == 5 * PIECE_BYTES


@pytest.mark.parametrize(
    ("packed", "code"),
    [
        (gzip.compress(b"data", mtime=0)[:-1], "truncated"),
        (gzip.compress(b"data", mtime=0) + b"x", "trailing_data"),
        (b"plain text", "corrupt_archive"),
        (gzip.compress(b"data", mtime=0)[:-4] + b"\0\0\0\1", "corrupt_archive"),
    ],
)
def test_what_gzip_did_not_write(packed: bytes, code: str) -> None:
    with pytest.raises(GzipError) as caught:
        inflate(packed)
    assert caught.value.code == code
