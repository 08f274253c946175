"""What an E57 says beside its points comes back: coordinate system, limits, sensor, times, invalid points."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import laspy
import numpy as np
import pye57
from pye57 import libe57

from pcdnf.formats import E57Flavour, PointCloud, read, write
from pcdnf.formats.e57.facts import Fact, limits, read_facts
from pcdnf.formats.e57.header import Scan

COUNT = 40
POINTS = np.random.default_rng(0).normal(size=(COUNT, 3))
WKT = 'PROJCS["ETRS89 / UTM zone 32N"]'
FACTS = (
    Fact("sensorVendor", "String", "Maker"),
    Fact("temperature", "Float", "20.5", (("precision", "single"),)),
    Fact(
        "acquisitionStart",
        "Structure",
        parts=(Fact("dateTimeValue", "Float", "1.25e9"), Fact("isAtomicClockReferenced", "Integer", "1")),
    ),
    Fact("originalGuids", "Vector", parts=(Fact("vectorChild", "String", "{a}"), Fact("vectorChild", "String", "{b}"))),
    limits("colorLimits", **{f"color{name}{end}": top for name in ("Red", "Green", "Blue")
                             for end, top in (("Minimum", 0), ("Maximum", 4095))}),
    limits("intensityLimits", intensityMinimum=0.0, intensityMaximum=2048.0),
)  # fmt: skip


def scanned(**attributes: Any) -> PointCloud:
    scan = Scan(0, COUNT, (), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "{g}", "Station", "", FACTS)
    created = Fact("creationDateTime", "Structure", parts=(Fact("dateTimeValue", "Float", "1.5e9"),))
    flavour = E57Flavour((scan,), WKT, 4095.0, (created,))
    return PointCloud(points=POINTS, attributes=attributes, flavour=flavour)


def test_every_fact_of_a_scan_comes_back(tmp_path: Path) -> None:
    write(tmp_path / "a.e57", scanned(intensity=np.arange(COUNT, dtype=np.float32)))
    cloud = read(tmp_path / "a.e57")
    assert cloud.warnings == []
    write(tmp_path / "b.e57", cloud.replaced(cloud.points + 1, None, metadata={}), check=True)
    with pye57.E57(str(tmp_path / "b.e57")) as file:
        assert file.image_file.root()["coordinateMetadata"].value() == WKT
        assert file.image_file.root()["creationDateTime"]["dateTimeValue"].value() == 1.5e9
        node = file.image_file.root()["data3D"][0]
        assert node["sensorVendor"].value() == "Maker"
        assert node["temperature"].value() == 20.5
        assert node["acquisitionStart"]["dateTimeValue"].value() == 1.25e9
        assert [node["originalGuids"][i].value() for i in range(2)] == ["{a}", "{b}"]
        assert node["colorLimits"]["colorGreenMaximum"].value() == 4095
        assert node["intensityLimits"]["intensityMaximum"].value() == 2048
        low = [node["cartesianBounds"][f"{axis}Minimum"].value() for axis in "xyz"]
    np.testing.assert_allclose(low, cloud.points.min(axis=0) + 1)


def test_colours_of_twelve_bits_stay_bright(tmp_path: Path) -> None:
    deep = {name: np.full(COUNT, value, np.uint16) for name, value in (("red", 4095), ("green", 2048), ("blue", 0))}
    write(tmp_path / "a.e57", scanned(**deep))
    cloud = read(tmp_path / "a.e57")
    write(tmp_path / "a.las", cloud, format="las")
    las = laspy.read(tmp_path / "a.las")
    assert (las.red[0], las.green[0], las.blue[0]) == (65535, 32776, 0)
    write(tmp_path / "a.ply", cloud, format="ply")
    assert read(tmp_path / "a.ply").attributes["red"].tolist() == [255] * COUNT
    write(tmp_path / "a.pcd", cloud, format="pcd")
    assert read(tmp_path / "a.pcd").attributes["green"].tolist() == [128] * COUNT


def test_new_files_have_limits_that_readers_scale_by(tmp_path: Path) -> None:
    colours = {name: np.full(COUNT, 200, np.uint8) for name in ("red", "green", "blue")}
    cloud = PointCloud(points=POINTS, attributes={**colours, "intensity": np.linspace(-5, 7, COUNT)})
    write(tmp_path / "a.e57", cloud, format="e57")
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        node = file.image_file.root()["data3D"][0]
        assert node["colorLimits"]["colorRedMaximum"].value() == 255
        assert node["intensityLimits"]["intensityMinimum"].value() == -5
        assert file.read_scan(0, colors=True, ignore_missing_fields=True)["colorRed"][0] == 200


def test_holes_are_marked_as_the_standard_asks(tmp_path: Path) -> None:
    points = POINTS.copy()
    points[3] = np.nan
    write(tmp_path / "a.e57", PointCloud(points=points), format="e57")
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        raw = file.read_scan_raw(0)
    assert np.flatnonzero(raw["cartesianInvalidState"]).tolist() == [3]
    cloud = read(tmp_path / "a.e57")
    assert cloud.holes is not None
    assert cloud.holes.rows.tolist() == [3]
    write(tmp_path / "b.e57", cloud, check=True)
    assert read(tmp_path / "b.e57").holes.rows.tolist() == [3]  # type: ignore[union-attr]


def test_binary_facts_are_said_to_be_lost(tmp_path: Path) -> None:
    write(tmp_path / "a.e57", scanned())
    image = libe57.ImageFile(str(tmp_path / "b.e57"), "w")
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    data = libe57.VectorNode(image, True)
    image.root().set("data3D", data)
    node = libe57.StructureNode(image)
    data.append(node)
    prototype = libe57.StructureNode(image)
    for name in ("cartesianX", "cartesianY", "cartesianZ"):
        prototype.set(name, libe57.FloatNode(image, 0.0))
    node.set("points", libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True)))
    grouping = libe57.StructureNode(image)
    grouping.set("blob", libe57.BlobNode(image, 8))
    node.set("pointGroupingSchemes", grouping)
    arrays = [np.arange(4.0), np.ones(4), np.ones(4)]
    buffers = libe57.VectorSourceDestBuffer()
    for name, values in zip(("cartesianX", "cartesianY", "cartesianZ"), arrays, strict=True):
        buffers.append(libe57.SourceDestBuffer(image, name, values, 4, True, True))
    writer = node["points"].writer(buffers)
    writer.write(4)
    writer.close()
    image.close()
    assert "'pointGroupingSchemes'" in read(tmp_path / "b.e57").warnings[0]


def test_facts_that_are_no_values_of_the_standard_are_left_out() -> None:
    wrong = (
        '<a type="Float">warm</a>',
        '<a type="Integer" maximum="3">4</a>',
        '<a type="Integer">99999999999999999999</a>',
        '<a type="Unknown">1</a>',
        '<a type="Structure"><b type="Blob"/></a>',
        "<a type='Structure'>" * 40 + "</a>" * 40,
    )
    for text in wrong:
        assert read_facts(ElementTree.fromstring(f"<scan>{text}</scan>"), ()) == ((), ["a"]), text
    (fact,), lost = read_facts(ElementTree.fromstring('<scan><a type="Float">2</a></scan>'), ())
    assert (fact, lost) == (Fact("a", "Float", "2"), [])
