"""Maps: values, their colours, and the numbers of the legend."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from pcdnf.errors import PcdnfError
from pcdnf.formats import PointCloud
from pcdnf.render.colour_maps import ColourScale, described, displacement, draw_legend, error


def plane(count: int = 2000, height: float = 0.0) -> PointCloud:
    points = np.random.default_rng(0).uniform(-5, 5, size=(count, 3))
    points[:, 2] = height
    return PointCloud(points=points + np.array([500_000, 4_480_000, 100]))


def test_displacement_is_in_the_unit_of_the_file() -> None:
    before, after = plane(), plane(height=0.25)
    np.testing.assert_allclose(displacement(before, after), 0.25, atol=1e-9)
    with pytest.raises(PcdnfError, match="2,000 and 30 points"):
        displacement(before, plane(30))


def test_error_is_the_distance_to_the_surface_in_the_unit_of_the_file() -> None:
    noisy = PointCloud(points=plane(500, height=0.1).points + np.array([0.01, 0, 0]))
    np.testing.assert_allclose(error(noisy, plane()), 0.1, atol=1e-6)


def test_a_scale_ends_at_a_round_number_above_nearly_all_values() -> None:
    values = np.r_[np.linspace(0, 0.0437, 1000), 9.0]
    scale = ColourScale.of(values)
    assert scale.top == pytest.approx(0.05)
    assert [label for _, label in scale.ticks] == ["0", "0.0125", "0.025", "0.0375", "0.05+"]
    assert ColourScale.of(np.array([1.0, 2.0]), np.array([2.9])).ticks[-1] == (3.0, "3")
    assert ColourScale.of(np.zeros(5)).top == 1.0
    assert ColourScale.of(np.r_[np.zeros(5000), 7.0]).top == 8.0


def test_colours_are_viridis_whose_lightness_rises_evenly() -> None:
    encoded = ColourScale(2.0, False).colours(np.linspace(0, 2, 101)) ** (1 / 2.2)
    np.testing.assert_allclose(encoded, colormaps["viridis"](np.linspace(0, 1, 101))[:, :3], atol=0.02)
    luminance = ColourScale(2.0, False).colours(np.linspace(0, 2, 101)) @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(luminance) > 0), "also in black and white"
    above = ColourScale(2.0, True).colours(np.array([2.0, 50.0]))
    np.testing.assert_array_equal(above[0], above[1])


def test_the_legend_shows_the_colours_from_0_to_the_top() -> None:
    scale = ColourScale(2.0, True)
    panel = Image.new("RGB", (400, 300))
    left, top, right, bottom = draw_legend(panel, scale, "mm", 10, (255, 255, 255))
    pixels = np.asarray(panel)
    for share, value in ((0.001, 0.0), (0.5, 1.0), (0.999, 2.0)):
        shown = pixels[(top + bottom) // 2 - 1, left + int((right - left) * share)] / 255
        np.testing.assert_allclose(shown, scale.colours(np.array([value]))[0] ** (1 / 2.2), atol=0.02)
    assert pixels[bottom + 4 :].max() > 200, "numbers under it"
    assert pixels[:top].max() == 0


def test_a_caption_has_three_numbers() -> None:
    assert described(np.linspace(0, 1, 101)) == "mean 0.5, 95 % below 0.95, maximum 1"
