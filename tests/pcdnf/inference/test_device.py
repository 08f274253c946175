import pytest
import torch

from pcdnf.inference.device import DeviceError, choose_device, choose_precision, has_native_bfloat16


def test_auto_takes_a_gpu_where_there_is_one() -> None:
    assert choose_device("auto") == ("cuda:0" if torch.cuda.is_available() else "cpu")
    assert choose_device("cpu") == "cpu"


@pytest.mark.parametrize("name", ["tpu", "cuda:x", "cuda0", ""])
def test_unknown_devices_are_refused(name: str) -> None:
    with pytest.raises(DeviceError, match="no device named"):
        choose_device(name)


def test_a_gpu_that_is_not_there_is_refused() -> None:
    with pytest.raises(DeviceError, match="no device cuda:99") as caught:
        choose_device("cuda:99")
    assert "cpu" in str(caught.value.hint)


def test_precision() -> None:
    native = has_native_bfloat16("cpu")
    assert choose_precision("auto", device="cpu") == ("bfloat16" if native else "float32")
    assert choose_precision("bfloat16", device="cpu") == "bfloat16"
    with pytest.raises(DeviceError, match="no precision named 'fp8'"):
        choose_precision("fp8", device="cpu")
