# SPDX-License-Identifier: Apache-2.0
import pytest

from multilica.fleet.tasks.guard import _connected


def _failing(*failures):
    left = list(failures)

    def connect():
        if left:
            raise left.pop(0)
        return "client"

    return connect


def test_a_loop_that_started_late_is_tried_once_more():
    assert _connected(_failing(AssertionError())) == "client"


@pytest.mark.parametrize(
    "failures", [(AssertionError(), AssertionError()), (OSError(),)], ids=["twice", "no scheduler"]
)
def test_what_fails_again_or_otherwise_is_raised(failures):
    with pytest.raises(type(failures[0])):
        _connected(_failing(*failures))
