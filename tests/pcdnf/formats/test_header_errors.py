from __future__ import annotations

import pytest

from pcdnf.formats import FormatError
from pcdnf.formats.header_errors import HeaderErrors

ERRORS = HeaderErrors("PLY header", "Export the file again.")


def test_a_broken_rule_names_the_line_and_the_way_out() -> None:
    with pytest.raises(FormatError, match=r"^Line 3 of the PLY header is wrong: it has no count\.$") as error:
        ERRORS.wrong("it has no count", line=3)
    assert (error.value.code, error.value.hint) == ("bad_header", "Export the file again.")
    with pytest.raises(FormatError, match=r"^The PLY header is wrong: it has no format line\.$"):
        ERRORS.wrong("it has no format line")


def test_a_line_that_is_too_long_names_the_limit() -> None:
    with pytest.raises(FormatError, match=r"^Line 2 is longer than 1000 bytes\.$") as error:
        ERRORS.too_long("Line 2", 1000)
    assert (error.value.code, error.value.limit) == ("header_too_long", 1000)


def test_a_file_of_another_size_than_declared_names_both_sizes() -> None:
    with pytest.raises(FormatError, match=r"header declares a file of at least 90 bytes; the file has 80\.$") as error:
        ERRORS.truncated(90, 80)
    assert (error.value.code, error.value.limit, error.value.actual) == ("truncated", 90, 80)
    with pytest.raises(FormatError, match=r"declares 9 vertices and a file of 90 bytes; the file has 80\.$"):
        ERRORS.truncated(90, 80, contents="9 vertices", exact=True)
    with pytest.raises(FormatError, match=r"declares a file of 90 bytes; the file has 99\.$") as error:
        ERRORS.trailing(90, 99, hint="Remove the rest.")
    assert (error.value.code, error.value.hint) == ("trailing_data", "Remove the rest.")
