from __future__ import annotations

import pytest
from pydantic import BaseModel, ValidationError

from service.api.intake.parameters import Parameters
from service.faults import reason
from service.settings import Settings


@pytest.mark.parametrize(
    ("setting", "value", "words"),
    [
        ("port", "x", "must be a whole number"),
        ("port", "70000", "must be at most 65535"),
        ("max_points", "0", "must be at least 1"),
        ("max_points", "4294967296.5", "must be a whole number"),
        ("upload_deadline", "0", "must be more than 0"),
        ("upload_deadline", "soon", "must be a number"),
        ("require_gpu", "perhaps", "must be true or false"),
        ("api_key", "short", "must have at least 16 characters"),
        ("log_format", "xml", "must be 'text' or 'json'"),
        ("device", "tpu", "must be auto, cpu or cuda:N, such as cuda:0"),
        ("device", "cuda:\N{ARABIC-INDIC DIGIT ONE}", "must be auto, cpu or cuda:N, such as cuda:0"),
        ("worker_id", "a b", "must have 1 to 64 letters, digits, points, hyphens or underscores"),
        ("storage_url", "ftp://host", "must be s3://bucket/prefix or file:///folder"),
    ],
)
def test_a_wrong_setting_is_refused_in_plain_words(setting: str, value: str, words: str) -> None:
    with pytest.raises(ValidationError) as error:
        Settings.model_validate({setting: value})
    assert [reason(fault) for fault in error.value.errors()] == [words]


def test_words_without_a_type_are_kept() -> None:
    assert reason({"loc": ("seed",), "msg": "given twice, with different values."}) == (
        "given twice, with different values"
    )


@pytest.mark.parametrize("model", [Settings, Parameters])
def test_no_value_is_checked_by_a_regular_expression_that_a_message_would_show(model: type[BaseModel]) -> None:
    assert "pattern" not in str(model.model_json_schema())
