# SPDX-License-Identifier: Apache-2.0
"""Poses in a recording or file, before calibration."""
