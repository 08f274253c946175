import numpy as np

from pcdnf.scanners.catalog import simulate
from pcdnf.scanners.crops import INNER, MARGIN, Cropper


def test_a_crop_is_measured_in_its_own_patch_radii() -> None:
    scan = simulate("graded", 4, 30_000)
    cropper, rng = Cropper(scan, 9.8), np.random.default_rng(0)
    crops = [crop for crop in (cropper.crop(rng, 48) for _ in range(6)) if crop is not None]
    assert len(crops) > 3
    for crop in crops:
        reach = np.linalg.norm(crop.points, axis=1)
        assert reach.max() <= INNER + MARGIN
        assert reach[crop.centres].max() <= INNER
        floor = crop.spacing * np.sqrt(48 / np.pi)
        assert np.isclose(max(9.8 * np.sqrt(crop.noise * crop.spacing), floor), 1.0)
        residual = ((crop.points - crop.clean) * crop.normals).sum(1)
        middle = reach < 0.7
        assert 0.5 < residual[middle].std() / crop.noise < 2


def test_mixed_pixels_are_never_centres() -> None:
    scan = simulate("depth-frame", 4, 30_000)
    cropper, rng = Cropper(scan, 9.8), np.random.default_rng(1)
    crops = [crop for crop in (cropper.crop(rng, 48) for _ in range(12)) if crop is not None]
    assert any((~crop.true).any() for crop in crops)
    assert all(crop.true[crop.centres].all() for crop in crops)


def test_the_floor_widens_quiet_crops() -> None:
    scan = simulate("terrestrial-room", 4, 30_000)
    cropper = Cropper(scan, 9.8)
    few = cropper.crop(np.random.default_rng(3), 40)
    many = cropper.crop(np.random.default_rng(3), 200)
    assert few is not None
    assert many is not None
    assert many.spacing < few.spacing
