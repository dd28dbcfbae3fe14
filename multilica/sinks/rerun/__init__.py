# SPDX-License-Identifier: Apache-2.0
"""Rerun recordings of calibrations."""
