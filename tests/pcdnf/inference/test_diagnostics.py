import numpy as np
import pytest

from pcdnf.inference.diagnostics import diagnose


def test_moves_are_weighed_by_the_noise() -> None:
    came = np.zeros((5, 3))
    moved = came.copy()
    moved[:, 0] = [0, 1, 2, 4, 0]
    found = diagnose(came, moved, np.array([1.0, 1, 1, 1, 0]))
    assert found.displacement.tolist() == [0, 1, 2, 4, 0]
    assert found.confidence.tolist() == pytest.approx([0, 1, 1, 0.2, 1])
    assert found.shares() == pytest.approx({"moved": 0.6, "left": 0.4, "doubtful": 0.2})
    assert found.metadata() == {"moved": "60.00%", "left": "40.00%", "doubtful": "20.00%"}
    assert list(found.columns()) == ["displacement", "estimated_noise", "confidence"]
    assert all(column.dtype == np.float32 for column in found.columns().values())
