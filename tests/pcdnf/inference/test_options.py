from typing import Any

import numpy as np
import pytest

from pcdnf.inference.options import (
    FAST_NEIGHBOURS,
    MOST_ITERATIONS,
    ChoiceError,
    check_fast,
    check_initial,
    check_iterations,
    check_radius,
    check_sensor,
)


@pytest.mark.parametrize(("value", "meant"), [("auto", None), ("3", 3), (2, 2), (np.int64(2), 2)])
def test_iterations(value: int | str, meant: int | None) -> None:
    found = check_iterations(value)
    assert found == meant
    assert type(found) is type(meant)


@pytest.mark.parametrize("value", ["0", "-1", "1.5", "many", "", 0, -3, 2.0, None, "9" * 5000, MOST_ITERATIONS + 1])
def test_iterations_that_cannot_be(value: Any) -> None:
    with pytest.raises(ChoiceError, match="auto or a whole number") as caught:
        check_iterations(value)
    assert caught.value.code == "invalid_iterations"


@pytest.mark.parametrize(
    ("value", "meant"), [("auto", None), ("4%", (0.04, True)), ("0.25", (0.25, False)), (12, (12.0, False))]
)
def test_radius(value: float | str, meant: tuple[float, bool] | None) -> None:
    assert check_radius(value) == meant


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", "101%", "0%", "4 cm", "", "%"])
def test_radius_that_cannot_be(value: str) -> None:
    with pytest.raises(ChoiceError, match="a percentage of its diagonal") as caught:
        check_radius(value)
    assert caught.value.code == "invalid_radius"


def test_fast_is_for_networks_that_were_trained_with_fewer_neighbours() -> None:
    assert check_fast(True, "lite") == FAST_NEIGHBOURS["lite"]
    assert check_fast(False, "lite") is None
    assert check_fast(False, "pcdnf") is None
    with pytest.raises(ChoiceError, match="no fast mode") as caught:
        check_fast(True, "pcdnf")
    assert caught.value.code == "no_fast_form"


@pytest.mark.parametrize("value", ["auto", "pca", "input"])
def test_raw_normals(value: str) -> None:
    assert check_initial(value) == value


@pytest.mark.parametrize("value", ["PCA", "", None])
def test_raw_normals_that_cannot_be(value: Any) -> None:
    with pytest.raises(ChoiceError, match="auto, pca or input") as caught:
        check_initial(value)
    assert caught.value.code == "invalid_initial"


@pytest.mark.parametrize(("value", "meant"), [("", None), ("1.5,0,2", (1.5, 0, 2)), ("-1e3, 2 ,3", (-1000, 2, 3))])
def test_sensor(value: str, meant: tuple[float, float, float] | None) -> None:
    assert check_sensor(value) == meant


@pytest.mark.parametrize("value", ["1,2", "1,2,3,4", "a,b,c", "1 2 3", "nan,0,0", "0,inf,0"])
def test_sensor_that_cannot_be(value: str) -> None:
    with pytest.raises(ChoiceError, match="three finite numbers with commas") as caught:
        check_sensor(value)
    assert caught.value.code == "invalid_sensor"
