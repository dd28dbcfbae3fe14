# SPDX-License-Identifier: Apache-2.0
import gc
import signal
import tempfile
from contextlib import ExitStack, contextmanager

import pytest
from threadpoolctl import threadpool_limits

pytest_plugins = ["tests.selection", "tests.slow_tests"]

# A shell without job control has what it starts in the background ignore Ctrl-C, and nohup has it ignore a hang-up; the
# processes of the tests would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_finish():
    """Keep collected tests from the search for garbage, which would take a tenth of the time of quick tests."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module")
def browser():
    """A browser without a screen; it ends with the module, as its event loop would be in the way of other tests."""
    from tests.sinks.browser import NoBrowserError, headless_browser

    with ExitStack() as stack:
        try:
            started = stack.enter_context(headless_browser())
        except NoBrowserError as error:
            pytest.skip(str(error))
        yield started


@contextmanager
def temporary_folder():
    """Lend this process, and those that it starts, a folder for temporary files, which ends with all that they left."""
    with tempfile.TemporaryDirectory(prefix="multilica-tests-") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", folder)
        patch.setattr(tempfile, "tempdir", folder)
        yield folder


@pytest.fixture(scope="session", autouse=True)
def _temporary_folder(tmp_path_factory):
    """Clusters of Dask, viewers and killed processes leave folders."""
    tmp_path_factory.getbasetemp()  # pytest keeps its own for some runs
    with temporary_folder():
        yield


@pytest.fixture(scope="session", autouse=True)
def _one_core():
    """Starting workers takes longer than most calibrations of the tests; commands that tests start have all cores."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("multilica.workers.processes.available_cores", lambda: 1)
        yield


@pytest.fixture(scope="module", autouse=True)
def _one_thread():
    """As in `calibrate`: on small matrices, the threads of BLAS take up to twenty times as long as one."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="session", autouse=True)
def _no_loss_of_power():
    """Files of tests need not outlast one, and waiting for the disk takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda _: None)
        yield
