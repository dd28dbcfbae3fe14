# SPDX-License-Identifier: Apache-2.0
"""The tabs and views that a recording opens with."""
