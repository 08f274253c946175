"""Reading and writing by path, the checks on numbers, and the check run in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcdnf.errors import PcdnfError
from pcdnf.file_formats import FORMATS, SUFFIXES, UNWRITTEN_SUFFIXES
from pcdnf.formats import CODES, FormatError, Limits, NpzFlavour, PcdFlavour, PlyFlavour, PointCloud, read, sniff, write
from pcdnf.formats.limits import bounds, finite_rows
from pcdnf.formats.point_cloud import row_ranges
from pcdnf.formats.sandbox.check import main
from pcdnf.formats.sandbox.limits import guarded

POINTS = np.random.default_rng(0).normal(size=(20, 3))
FLAVOURS = {
    "binary": PlyFlavour(),
    "text": PlyFlavour("ascii"),
    "big-endian": PlyFlavour("binary_big_endian"),
    "npz": NpzFlavour(),
    "pcd": PcdFlavour(),
    "pcd-text": PcdFlavour("ascii"),
    "pcd-compressed": PcdFlavour("binary_compressed"),
}


@pytest.fixture(params=FLAVOURS.values(), ids=FLAVOURS)
def stored(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    """A function that stores points, and what goes with them, in each flavour."""

    def store(points: Any, **others: Any) -> Path:
        path = tmp_path / "cloud"
        write(path, PointCloud(points=np.asarray(points), flavour=request.param, **others))
        return path

    return store


def refusal(path: Path, **limits: Any) -> FormatError:
    with pytest.raises(FormatError) as caught:
        read(path, limits=Limits(**limits))
    return caught.value


# By its first bytes


def test_sniffing() -> None:
    assert sniff(b"ply\nformat") == "ply"
    assert sniff(b"ply\r\n") == "ply"
    assert sniff(b"PK\x03\x04") == "npz"
    assert sniff(b"# .PCD v.7") == "pcd"
    assert sniff(b"VERSION .7") == "pcd"
    assert sniff(b"LASF") == "las"
    assert sniff(b"ASTM-E57") == "e57"


@pytest.mark.parametrize("head", [b"ply", b"plyformat", b"PLY\n", b"solid", b"PK\x05\x06", b" ply\n", b"\x80\x04"])
def test_unknown_first_bytes(tmp_path: Path, head: bytes) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(head + bytes(100))
    assert refusal(path).code == "unknown_format"


def test_an_empty_file(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    path.touch()
    assert refusal(path).code == "empty_file"


def test_the_name_does_not_count(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    write(path, PointCloud(points=POINTS), format="ply")
    assert read(path).flavour.format == "ply"


def test_paths_that_lead_nowhere(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "none", tmp_path, tmp_path / "pipe", tmp_path / ("n" * 4000), Path("a\0b")):
        assert refusal(path).code == "unreadable_file"


def test_a_file_over_the_byte_limit(stored: Any) -> None:
    path = stored(POINTS)
    size = path.stat().st_size
    error = refusal(path, max_bytes=size - 1)
    assert (error.code, error.limit, error.actual) == ("file_too_large", size - 1, size)


# Numbers


@pytest.mark.parametrize("least", [19, 20, 21])
def test_the_minimum_of_points(stored: Any, least: int) -> None:
    path = stored(POINTS)
    if least <= len(POINTS):
        assert len(read(path, limits=Limits(minimum_points=least))) == len(POINTS)
    else:
        error = refusal(path, minimum_points=least)
        assert (error.code, error.limit, error.actual) == ("too_few_points", 21, 20)


@pytest.mark.parametrize("most", [19, 20, 21])
def test_the_maximum_of_points(stored: Any, most: int) -> None:
    path = stored(POINTS)
    if most >= len(POINTS):
        assert len(read(path, limits=Limits(max_points=most))) == len(POINTS)
    else:
        error = refusal(path, max_points=most)
        assert (error.code, error.limit, error.actual) == ("too_many_points", 19, 20)


def test_no_points(stored: Any) -> None:
    error = refusal(stored(POINTS[:0]))
    assert (error.code, error.limit, error.actual) == ("too_few_points", 1, 0)


def spoiled() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    points, normals = POINTS.copy(), np.ones_like(POINTS)
    points[3, 1], points[4, 0], normals[7, 2] = np.nan, -np.inf, np.nan
    return points, normals


def test_rows_that_are_not_finite_are_counted(stored: Any) -> None:
    points, normals = spoiled()
    error = refusal(stored(points, normals=normals), nonfinite="reject")
    assert (error.code, error.actual) == ("nonfinite", 2)
    assert "row 3 " in str(error)
    assert "nonfinite=drop" in str(error.hint)


def test_holes_come_back_in_their_places(stored: Any, tmp_path: Path) -> None:
    points, normals = spoiled()
    tags = np.arange(20, dtype=np.int32)
    cloud = read(stored(points, normals=normals, attributes={"tag": tags}))
    kept = [row for row in range(20) if row not in (3, 4)]
    assert cloud.attributes["tag"].tolist() == kept
    assert np.isnan(cloud.normals[5, 2]), "a normal that is NaN is a missing normal"  # type: ignore[index]
    assert "2 of 20 rows have no coordinates" in cloud.warnings[-1]
    write(tmp_path / "out", cloud.replaced(cloud.points + 1, np.ones_like(cloud.points), metadata={}), check=True)
    again = read(tmp_path / "out")
    np.testing.assert_array_equal(again.points, POINTS[kept] + 1)
    assert again.holes is not None
    assert again.holes.rows.tolist() == [3, 4]
    assert again.holes.attributes["tag"].tolist() == [3, 4]
    np.testing.assert_array_equal(again.whole().attributes["tag"], tags)


def test_outliers_beside_holes_go_by_their_numbers_in_the_file(stored: Any) -> None:
    points, _ = spoiled()
    cloud = read(stored(points)).without(np.array([0, 3]), "Outliers")
    assert cloud.dropped.tolist() == [0, 5]
    assert len(cloud.whole()) == 18


def test_dropping_keeps_the_order_and_says_which(stored: Any, tmp_path: Path) -> None:
    points, normals = spoiled()
    path = stored(points, normals=normals, attributes={"tag": np.arange(20, dtype=np.int32)})
    cloud = read(path, limits=Limits(nonfinite="drop"))
    kept = [row for row in range(20) if row not in (3, 4)]
    assert cloud.attributes["tag"].tolist() == kept
    np.testing.assert_array_equal(cloud.points, POINTS[kept])
    assert cloud.dropped.tolist() == [3, 4]
    assert "3-4 (2 rows)" in cloud.warnings[-1]
    write(tmp_path / "out", cloud.replaced(cloud.points, None, metadata={"seed": "0"}))
    assert read(tmp_path / "out").metadata == {"seed": "0", "dropped_rows": "3-4 (2 rows)"}


def test_dropping_may_leave_too_few(stored: Any) -> None:
    points, _ = spoiled()
    error = refusal(stored(points), nonfinite="drop", minimum_points=19)
    assert (error.code, error.actual) == ("too_few_points", 18)


def test_attributes_may_hold_anything(stored: Any) -> None:
    intensity = np.full(20, np.nan, np.float32)
    np.testing.assert_array_equal(read(stored(POINTS, attributes={"i": intensity})).attributes["i"], intensity)


def test_ranges_of_rows_are_bounded() -> None:
    assert row_ranges(np.array([5])) == "5 (1 row)"
    text = row_ranges(np.arange(0, 10_000, 2))
    assert len(text) < 450
    assert text.endswith("… (5000 rows)")


@pytest.mark.parametrize("scale", [1e-14, 1e-200, 1e13, 1e30, 1e200, 4e307])
def test_extents_that_are_refused(stored: Any, scale: float) -> None:
    assert refusal(stored(POINTS / 4 * scale)).code == "extent_out_of_range"


@pytest.mark.parametrize("scale", [1e-12, 1e10])
def test_extents_that_are_accepted(stored: Any, scale: float) -> None:
    np.testing.assert_array_equal(read(stored(POINTS * scale)).points, POINTS * scale)


def test_equal_points_have_no_extent(stored: Any) -> None:
    assert refusal(stored(np.full((20, 3), 7.0))).code == "zero_extent"
    assert refusal(stored(POINTS[:1])).code == "zero_extent"


def test_flat_and_far_clouds_are_accepted(stored: Any) -> None:
    line = np.outer(np.arange(20.0), [1, 0, 0])
    np.testing.assert_array_equal(read(stored(line)).points, line)
    utm = POINTS + np.array([500_000.123, 4_480_000.12, 0])
    np.testing.assert_array_equal(read(stored(utm)).points, utm)


# Writing


def test_a_result_takes_the_types_of_its_file() -> None:
    cloud = PointCloud(points=POINTS.astype(np.float32), normals=POINTS)
    result = cloud.replaced(POINTS, POINTS.astype(np.float32), metadata={})
    assert result.points.dtype == np.float32
    assert result.normals is not None
    assert result.normals.dtype == np.float64
    assert cloud.replaced(POINTS, None).normals is cloud.normals


def test_clouds_that_contradict_themselves() -> None:
    for arguments in (
        {"points": np.zeros((3, 2))},
        {"points": np.zeros((3, 3), int)},
        {"points": np.zeros((3, 3)), "normals": np.zeros((2, 3))},
        {"points": np.zeros((3, 3)), "attributes": {"a": np.zeros(2)}},
    ):
        with pytest.raises(ValueError, match=r"float32 or float64|match|rows"):
            PointCloud(**arguments)


def test_limits_that_make_no_sense() -> None:
    for arguments in ({"max_points": 0}, {"nonfinite": "mend"}):
        with pytest.raises(ValueError, match="must be"):
            Limits(**arguments)  # type: ignore[arg-type]


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(b"old")
    cloud = PointCloud(points=POINTS, attributes={"a": np.full(20, 2**60)})
    with pytest.raises(FormatError, match="'a'"):
        write(path, cloud)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", [suffix for format_ in FORMATS.values() for suffix in format_.suffixes])
def test_the_extension_chooses_the_format(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"cloud{suffix.upper()}"
    write(path, PointCloud(points=POINTS))
    assert FORMATS[read(path).flavour.format] == FORMATS[SUFFIXES[suffix]]


def test_text_of_any_columns_keeps_its_layout(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("x,y,z\n" + "".join(f"{x},{y},{z}\n" for x, y, z in POINTS))
    write(tmp_path / "b.txt", read(tmp_path / "a.txt"))
    write(tmp_path / "b.pts", read(tmp_path / "a.txt"))
    assert "," in (tmp_path / "b.txt").read_text()
    scan = f"{len(POINTS)}\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    (tmp_path / "a.ptx").write_text(scan + "".join(f"{x} {y} {z} 0.5\n" for x, y, z in POINTS))
    write(tmp_path / "c.txt", read(tmp_path / "a.ptx"))
    np.testing.assert_allclose(read(tmp_path / "c.txt").points, POINTS, rtol=1e-6)
    assert "," not in (tmp_path / "b.pts").read_text()


@pytest.mark.parametrize("name", ["cloud", "cloud.dat", "cloud.v2"])
def test_without_a_known_extension_the_format_is_that_of_the_cloud(name: str, tmp_path: Path) -> None:
    write(tmp_path / name, PointCloud(points=POINTS, flavour=PcdFlavour()))
    assert read(tmp_path / name).flavour.format == "pcd"


@pytest.mark.parametrize("suffix", UNWRITTEN_SUFFIXES)
def test_extensions_that_are_only_read_are_refused(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=f"end in {suffix} cannot be written") as caught:
        write(tmp_path / f"cloud.ply{suffix}", PointCloud(points=POINTS))
    assert caught.value.code == "unwritten_format"
    assert not list(tmp_path.iterdir())


def test_a_written_file_has_the_usual_permissions(tmp_path: Path) -> None:
    write(tmp_path / "cloud.ply", PointCloud(points=POINTS))
    (tmp_path / "other").touch()
    assert (tmp_path / "cloud.ply").stat().st_mode == (tmp_path / "other").stat().st_mode


# Errors


def test_format_errors_are_ours_and_have_a_known_code() -> None:
    assert issubclass(FormatError, PcdnfError)
    with pytest.raises(ValueError, match="CODES"):
        FormatError("Text.", code="made_up", hint="None.")
    assert all(code == code.lower() and text for code, text in CODES.items())


# The check in a process of its own


def check(path: Path, *options: str) -> dict[str, Any]:
    command = [sys.executable, "-m", "pcdnf.formats.sandbox.check", str(path), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stderr == ""
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def test_check_accepts(stored: Any) -> None:
    answer = check(stored(POINTS, normals=POINTS), "--memory-bytes", "100000000", "--cpu-seconds", "20")
    assert answer.pop("format") in FORMATS
    assert answer.pop("diagonal") == pytest.approx(np.linalg.norm(np.ptp(POINTS, axis=0)), rel=1e-6)
    assert answer == {"ok": True, "points": 20, "has_normals": True, "dropped": 0, "warnings": []}


def test_check_refuses_with_status_0(stored: Any) -> None:
    answer = check(stored(POINTS), "--limits-json", '{"max_points": 10}')
    assert answer["ok"] is False
    assert (answer["code"], answer["limit"], answer["actual"]) == ("too_many_points", 10, 20)
    assert answer["detail"].endswith(".")
    assert answer["hint"].endswith(".")


def test_check_under_a_memory_limit(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    write(path, PointCloud(points=np.random.default_rng(0).normal(size=(400_000, 3))))
    assert check(path, "--memory-bytes", "5000000")["code"] == "not_enough_memory"
    assert check(path, "--memory-bytes", "200000000")["ok"] is True


def test_check_under_a_time_limit(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    lines = ["element vertex 1", *(f"property float {axis}" for axis in "xyz")]
    lines += ["element face 6000000", "property list uchar uchar at"]
    head = "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode()
    path.write_bytes(head + bytes(12) + b"\0\1\1" * 3_000_000)
    assert check(path, "--cpu-seconds", "1")["code"] == "took_too_long"


def test_a_full_disk_is_answered_too() -> None:
    def fill() -> dict[str, Any]:
        with open("/dev/full", "wb") as file:
            file.write(b"x")
        return {"ok": True}

    answer = guarded(fill)
    assert (answer["ok"], answer["code"], answer["hint"]) == (False, "disk_full", "Try again later.")


def test_check_says_what_is_wrong_with_its_arguments(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["cloud.ply", "--limits-json", '{"max_pints": 1}'])
    assert ended.value.code == 2
    assert "max_pints" in capsys.readouterr().err


def test_formats_do_not_import_torch() -> None:
    command = (
        "import sys, pcdnf.formats.sandbox.check; assert 'torch' not in sys.modules and 'scipy' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", command], check=True, timeout=60)


def test_reading_keeps_no_descriptor_open(stored: Any) -> None:
    path = stored(POINTS)
    before = os.dup(0)
    os.close(before)
    for _ in range(3):
        read(path)
        refusal(path, max_points=1)
    after = os.dup(0)
    os.close(after)
    assert after == before, "the lowest free descriptor is the same"


def test_bounds_and_finite_rows_are_those_of_numpy() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    low, high = bounds(points)
    assert low.dtype == np.float64
    np.testing.assert_array_equal(low, points.min(axis=0))
    np.testing.assert_array_equal(high, points.max(axis=0))
    points[3, 2], points[9, 0] = np.nan, np.inf
    assert np.flatnonzero(~finite_rows(points)).tolist() == [3, 9]
