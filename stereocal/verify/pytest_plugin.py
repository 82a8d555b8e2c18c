"""The pytest fixture ``stereocal_check``: a user's own functions against the references, in the user's own test-suite.

Installed with stereocal (entry point ``pytest11``); costs nothing until a test asks for it::

    def test_my_harris(stereocal_check):
        stereocal_check("harris_response", my_harris)

The test fails with the report's sentence if the function differs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from stereocal.verify.function_checks import FunctionReport


@pytest.fixture
def stereocal_check() -> Callable[..., FunctionReport]:
    """Return a function of kernel, function and options that fails the test unless the function agrees.

    The options are those of :func:`stereocal.verify.function_checks.check_function`; the report is returned.
    """

    def check(kernel: str, function: Callable[..., Any], **options: Any) -> FunctionReport:
        __tracebackhide__ = True
        from stereocal.verify.function_checks import check_function

        report = check_function(kernel, function, **options)
        if not report.agrees:
            pytest.fail(str(report), pytrace=False)
        return report

    return check
