# SPDX-License-Identifier: Apache-2.0
"""Worker processes: the same results with any number of them."""

from multilica.workers.messages import Shared
from multilica.workers.processes import Workers, available_cores, open_workers

__all__ = ["Shared", "Workers", "available_cores", "open_workers"]
