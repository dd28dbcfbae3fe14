# SPDX-License-Identifier: Apache-2.0
"""Sinks that turn the events of a calibration into files."""
