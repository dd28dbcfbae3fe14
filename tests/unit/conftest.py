# SPDX-License-Identifier: Apache-2.0
import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(scope="module", autouse=True)
def _one_thread():
    """As in `calibrate`: thousands of 3x3 problems are slower with the threads of BLAS than without."""
    with threadpool_limits(1):
        yield
